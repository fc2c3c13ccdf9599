"""Where lines come from: standard input, a named pipe, a file that grows. A broker is in mqtt.py.

A channel is asked for one line at a time and waits for it at most as long as it is told. It holds a bounded number of
bytes: a pipe that is full makes its writer wait.
"""

from __future__ import annotations

import os
import queue
import stat
import threading
import time
from collections import deque
from pathlib import Path
from typing import Protocol

from dafw.core.errors import ReadingsError
from dafw.plugins.readings.feed.lines import Line, Splitter

CHUNK = 65536
WAITING_LINES = 1000
"""Lines of a pipe that are read ahead."""
POLL = 0.02
"""Seconds between two looks at a file that has not grown."""


class Channel(Protocol):
    """A source of lines."""

    offset: int
    """Bytes of a file that have become lines; 0 for what cannot be read again."""
    ended: bool
    """Whether no more lines can come; those that did come may still be asked for."""

    def next(self, seconds: float) -> Line | None:
        """Return the next line, waiting for it at most so long; None if there is none."""

    def close(self) -> None:
        """Release it."""


class Pipe:
    """Standard input or a named pipe, read by a thread. A named pipe stays open when its writer has gone."""

    offset = 0

    def __init__(self, source: int | Path) -> None:
        self.ended = False
        self._lines: queue.Queue[Line | None] = queue.Queue(WAITING_LINES)
        if isinstance(source, int):
            try:
                os.fstat(source)
            except OSError:
                raise ReadingsError("readings 'live': standard input is closed, and it is the source") from None
        self._source = source
        threading.Thread(target=self._read, name="dafw feed", daemon=True).start()

    def _read(self) -> None:
        if isinstance(self._source, int):
            self._until_end(self._source)
            self._lines.put(None)
            return
        while True:  # opening waits for the next writer
            with self._source.open("rb", buffering=0) as stream:
                self._until_end(stream.fileno())

    def _until_end(self, descriptor: int) -> None:
        splitter = Splitter()
        while data := _read(descriptor):
            for line in splitter.feed(data):
                self._lines.put(line)
        for line in splitter.finish():
            self._lines.put(line)

    def next(self, seconds: float) -> Line | None:
        """Return the next line; None if none came in time or the stream has ended."""
        if self.ended:
            return None
        try:
            line = self._lines.get(block=seconds > 0.0, timeout=seconds or None)
        except queue.Empty:
            return None
        self.ended = line is None
        return line

    def close(self) -> None:
        """Leave the thread, which ends with the process: it may wait for its stream."""


def _read(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, CHUNK)
    except OSError:  # a terminal that was closed
        return b""


class GrowingFile:
    """A file that others write to. It need not exist yet; one that is replaced or cut short is read from its start."""

    def __init__(self, path: Path, offset: int = 0) -> None:
        self.path, self.ended = path, False
        self._read_to = offset
        self._descriptor: int | None = None
        self._splitter = Splitter(offset)
        self._lines: deque[Line] = deque()
        self.offset = offset

    def next(self, seconds: float) -> Line | None:
        """Return the next line; None if the file has not grown by one in time."""
        deadline = time.monotonic() + seconds
        while not self._lines and not self._more():
            left = deadline - time.monotonic()
            if left <= 0.0:
                return None
            time.sleep(min(left, POLL))
        line = self._lines.popleft()
        self.offset = line.end
        return line

    def _more(self) -> bool:
        """Read on, and return whether there are lines; raises ReadingsError if the file cannot be read."""
        try:
            if self._descriptor is None:
                self._descriptor = os.open(self.path, os.O_RDONLY)
                if os.fstat(self._descriptor).st_size < self._read_to:
                    self._restart()  # not the file that was read before
                os.lseek(self._descriptor, self._read_to, os.SEEK_SET)
            data = os.read(self._descriptor, CHUNK)
        except FileNotFoundError:
            return False
        except OSError as error:
            raise ReadingsError(f"readings 'live': {self.path} cannot be read ({error.strerror or error})") from None
        if not data:
            self._begin_anew()
            return False
        self._read_to += len(data)
        self._lines.extend(self._splitter.feed(data))
        return bool(self._lines)

    def _begin_anew(self) -> None:
        """Leave a file that was replaced, or cut short, for the one that now has its name."""
        if self._descriptor is None:
            return
        try:
            there = self.path.stat()
        except OSError:
            return  # between two files
        here = os.fstat(self._descriptor)
        if (here.st_ino, here.st_dev) != (there.st_ino, there.st_dev) or there.st_size < self._read_to:
            self.close()
            self._restart()

    def _restart(self) -> None:
        self._read_to = self.offset = 0
        self._splitter = Splitter()

    def close(self) -> None:
        """Close the file."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def __del__(self) -> None:
        self.close()


def channel_to(source: str, offset: int = 0) -> Channel:
    """Return the channel that an option says: ``-`` for standard input, or a path; a file is read from ``offset``."""
    if source == "-":
        return Pipe(0)
    path = Path(source).expanduser()
    try:
        if stat.S_ISFIFO(path.stat().st_mode):
            return Pipe(path)
    except OSError:
        pass  # a file that does not exist yet
    return GrowingFile(path, offset)
