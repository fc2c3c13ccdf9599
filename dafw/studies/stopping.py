"""Stopping a run on request: between two cycles, so that all results so far are kept."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Interrupted(KeyboardInterrupt):
    """The run was asked to stop (Ctrl-C or SIGTERM); the finished cycles are kept."""


class Stop:
    """Whether the run was asked to stop.

    During set-up, which may take minutes, a request stops the run at once. Later, when ``patient`` is set, the run
    stops between two cycles, never while a file is being written.
    """

    def __init__(self) -> None:
        self.asked = self.patient = False

    def agreed(self, communicator: Any) -> bool:
        """Return whether any rank of an MPI communicator was asked to stop; then all ranks stop."""
        if communicator is not None:
            self.asked = any(communicator.allgather(self.asked))
        return self.asked

    def __call__(self, number: int, frame: Any) -> None:
        """Note the signal."""
        if not self.patient or (self.asked and number == signal.SIGINT):
            raise KeyboardInterrupt  # a second Ctrl-C stops at once
        self.asked = True


@contextmanager
def stop_signals() -> Iterator[Stop]:
    """Let Ctrl-C and SIGTERM stop a run: at once during set-up, later at the end of the present cycle."""
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
