"""What tests ask of processes."""

import os


def alive(pid):
    """Say whether a process is there; one that ended and was not waited for still is."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
