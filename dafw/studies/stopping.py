"""Ending a run when asked to: between two cycles, with everything kept."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Interrupted(KeyboardInterrupt):
    """The run was asked to stop (Ctrl-C or SIGTERM); what was done is kept."""


class Stop:
    """Whether the run was asked to stop.

    It does so at once during set-up, which may take minutes, and later, when it is ``patient``, between two cycles,
    never while a file is being written.
    """

    def __init__(self) -> None:
        self.asked = self.patient = False

    def agreed(self, communicator: Any) -> bool:
        """Say whether any rank of an MPI communicator was asked to stop, and have it asked of all."""
        if communicator is not None:
            self.asked = any(communicator.allgather(self.asked))
        return self.asked

    def __call__(self, number: int, frame: Any) -> None:
        """Note the signal."""
        if not self.patient or (self.asked and number == signal.SIGINT):
            raise KeyboardInterrupt  # nor does the second Ctrl-C wait
        self.asked = True


@contextmanager
def stop_signals() -> Iterator[Stop]:
    """Let Ctrl-C and SIGTERM end a run: in set-up at once, then after the cycle that it is in, with everything kept."""
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    previous = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
