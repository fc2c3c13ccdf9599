"""Functions for worker processes to call."""

import os
import signal
import time
from pathlib import Path

from dafw.core.errors import SolverError
from dafw.core.workers import outcome, spare_cores


def squared(number):
    """Return the square and the number of the process; thirteen is refused."""

    def square():
        if number == 13:
            raise SolverError("no square of 13")
        return number**2, os.getpid()

    return outcome("squares", square)


def killed():
    os.kill(os.getpid(), signal.SIGKILL)


def killed_once(marker, number):
    if not Path(marker).exists():
        Path(marker).touch()
        killed()
    return outcome("errands", lambda: number)


def slow(seconds, marker=None):
    time.sleep(seconds)
    if marker:
        Path(marker).touch()
    return outcome("errands", os.getpid)


def cores_to_spare():
    return outcome("errands", spare_cores)


def ranks_known():
    return outcome("errands", lambda: sorted(name for name in os.environ if name.startswith(("PMI_", "OMPI_"))))
