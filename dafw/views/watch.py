"""Serves the page of a run to browsers on this machine, with what is new while the run goes on."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import Any
from urllib.parse import SplitResult, parse_qs

from dafw.core.errors import RunError
from dafw.core.forecasts.forecast_file import FILE as FORECASTS
from dafw.core.runs import summary_of
from dafw.views.files import load_run
from dafw.views.local_server import LocalAnswers, LocalServer
from dafw.views.report_page import as_json, page
from dafw.views.report_run import page_of_run

ENDED = ("complete", "failed")
"""States of a run to which nothing is added any more. One that goes on is 'interrupted' until it has ended."""
SHARE = 0.1
"""The share of a processor that reading the run may take, so that a large one is not slowed down by who looks at it."""
PAUSE = 0.5
"""Seconds between two looks for a run that has not begun."""
PATIENCE = 10
"""How often a run's file may be found unreadable before it is given up."""


class Following:
    """What is known of a run that may go on, read anew when its files have changed; all viewers share it.

    ``clock`` tells the time, ``used`` the processor's time that reading has taken, both in seconds.
    """

    def __init__(
        self,
        folder: Path,
        clock: Callable[[], float] = time.monotonic,
        used: Callable[[], float] = time.thread_time,
    ) -> None:
        self.folder, self._clock, self._used = folder, clock, used
        self._lock = Lock()
        self._seen: tuple[float, float, str] | None = None
        self._due = 0.0
        self._data: dict[str, Any] | None = None

    def data(self) -> dict[str, Any]:
        """Return the data of the page as they are now; raises RunError if the run could never be read."""
        with self._lock:
            status = str(summary_of(self.folder).get("status", ""))
            try:
                recorded = (self.folder / "run.nc").stat().st_mtime
            except OSError as error:
                raise RunError(f"{self.folder}: holds no run (expected a run's folder)") from error
            # A forecast is made after the row of its time was written, and the next row may be long in coming.
            ahead = self.folder / FORECASTS
            seen = (recorded, ahead.stat().st_mtime if ahead.exists() else 0.0, status)
            # What a run ends with is read at once.
            is_due = self._clock() >= self._due or status in ENDED
            if self._data is None or (seen != self._seen and is_due):
                self._read(seen)
            assert self._data is not None
            return self._data

    def _read(self, seen: tuple[float, float, str]) -> None:
        begun, is_first = self._used(), self._data is None
        try:
            data = page_of_run(load_run(self.folder / "run.nc"), self.folder)
        except RunError:
            if self._data is None:
                raise
            return  # the run is writing just now: what was read before stays until the next question
        finally:
            # The first reading loads the libraries, too, and says nothing of the next ones.
            self._due = self._clock() + (0.0 if is_first else (self._used() - begun) / SHARE)
        self._seen = seen
        status = seen[-1]
        issues = len((data["forecasts"] or {"issues": []})["issues"])
        state = f"{len(data['time']['values'])} {issues} {status}"
        self._data = data | {"live": {"state": state, "ended": status in ENDED}}


class Server(LocalServer):
    """Answers browsers on this machine alone."""

    def __init__(self, following: Following, port: int = 0) -> None:
        self.following = following
        super().__init__(_Answers, port, "watch")


class _Answers(LocalAnswers):
    """The page at /, and at /data what is new since the state that a page has."""

    server: Server

    def reply(self, asked: SplitResult) -> None:
        if asked.path not in ("/", "/data"):
            return self.answer(404, "text/plain", "There is nothing here.")
        try:
            data = self.server.following.data()
        except RunError as error:
            return self.answer(503, "text/plain", str(error))
        if asked.path == "/":
            return self.answer(200, "text/html", page(data))
        if parse_qs(asked.query).get("state") == [data["live"]["state"]]:
            return self.answer(204, "application/json", "")
        return self.answer(200, "application/json", as_json(data))


def watch(path: Path, port: int = 0) -> None:
    """Serve the page of the run at ``path`` until Ctrl-C, and print its address.

    A run that has not recorded anything yet is waited for. Raises RunError if there is no such folder or its file
    stays unreadable, ConfigurationError if the port cannot be used.
    """
    folder = path if path.is_dir() else path.parent
    if not folder.is_dir() or (path != folder and path.name != "run.nc"):
        raise RunError(f"{path}: holds no run (expected a run's folder)")
    following = Following(folder)
    try:
        _wait_for(following)
        with Server(following, port) as server:
            print(server.address, flush=True)
            server.serve_forever()
    except KeyboardInterrupt:
        return


def _wait_for(following: Following) -> None:
    """Wait until a run has begun; raises RunError if its file is there for a while and still cannot be read."""
    if not (following.folder / "run.nc").exists():
        print(f"dafw: waiting for a run in {following.folder}", file=sys.stderr, flush=True)
    failed = 0
    while True:
        try:
            following.data()
            return
        except RunError:
            failed += (following.folder / "run.nc").exists()
            if failed >= PATIENCE:
                raise
        time.sleep(PAUSE)
