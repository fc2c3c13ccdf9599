"""The journal of a live run: every line that came, as it came, and the cycle that it came in.

A new run with the journal as its source takes the same lines in the same cycles. A run that was killed and goes on
takes first what its own journal has and its checkpoint has not. The file is JSON lines:

    {"journal": 1, "zero": 1764482400.0, "client": "..."}   zero: the Unix time of t = 0, null where that is not known
    {"cycle": 0, "at": 1764482401.2, "line": "..."}         at: the Unix time at which the line came
    {"cycle": 0, "at": 1764482401.3, "left_out": "too_long", "count": 1}
    {"cycle": 0, "end": true}                               the cycle had its readings

Entries of a file that grows, and of a broker, also have ``offset``, where the file, or the inbox (inbox.py), was read
to. A line that is too long is not kept.
``client`` is the name by which a broker knows the run. A feed that ended without saying so, because its pipe was closed
or because it was silent for too long, has a line ``{"end": true}`` in the journal.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic
from typing import Any, BinaryIO

from dafw.core.errors import ReadingsError, RecordError
from dafw.plugins.readings.feed.lines import Line

FILE = "journal.jsonl"
SYNC_SECONDS = 1.0
"""The journal is written to the disk at the end of a cycle, if that was so long ago."""
LONGEST_ENTRY = 1 << 20
"""Bytes of an entry: a line of control characters takes six times its length as JSON."""
LATEST = 1e12
"""Seconds of the Unix time, some 30,000 years, that no journal can reach."""
LARGEST = 2**62
"""Bytes that no file has."""


@dataclass(frozen=True)
class Entry:
    """An entry: a line, the Unix time at which it came, and how far a file was read; or the end of a cycle.

    ``own``: it stands in the run's own journal already.
    """

    line: Line = field(default_factory=Line)
    at: float = 0.0
    cycle: int = 0
    ends: bool = False
    offset: int = 0
    own: bool = False


@dataclass(frozen=True)
class Head:
    """The first line of a journal: the Unix time of t = 0 where it is known, and the run's name at its broker."""

    zero: float | None
    client: str


def head_of(path: Path) -> Head | None:
    """Return the first line of a journal; None if the file is none."""
    if not path.is_file():  # a named pipe would make its reader wait
        return None
    try:
        with path.open("rb") as stream:
            head = json.loads(stream.readline(LONGEST_ENTRY))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(head, dict) or head.get("journal") != 1:
        return None
    zero = head.get("zero")
    if not isinstance(zero, int | float) or not abs(zero) < LATEST:
        zero = None
    return Head(None if zero is None else float(zero), str(head.get("client", "")))


def cycles_in(path: Path) -> int:
    """Return how many cycles of a journal have all their readings; 0 if there is no journal."""
    return reached(path)[0]


def reached(path: Path) -> tuple[int, int]:
    """Return how many cycles of a journal have all their readings, and how far its source was read (bytes).

    Both are 0 if there is no journal.
    """
    cycles, last = 0, b""
    if path.is_file():
        with path.open("rb") as stream:
            for line in stream:  # within a line that came, a quotation mark has a backslash before it
                cycles += line.endswith(b'"end": true}\n')
                last = line if b', "offset": ' in line and line.endswith(b"}\n") else last
    try:
        return cycles, _entry(last, path, cycles).offset if last else 0
    except ReadingsError:  # it is refused, with its number, when it is taken
        return cycles, 0


def entries_of(path: Path, taken: int = 0) -> Iterator[Entry]:
    """Yield the entries of a journal after the first ``taken``.

    Raises ReadingsError for an entry that is damaged, and if there are fewer than ``taken``.
    """
    with path.open("rb") as stream:
        stream.readline(LONGEST_ENTRY)
        number = 0
        # An entry without a line end was being written when the run was killed.
        while (data := stream.readline(LONGEST_ENTRY)).endswith(b"\n"):
            number += 1
            if number > taken:
                yield _entry(data, path, number)
    if number < taken:
        raise ReadingsError(f"journal {path}: has {number} entries, {taken} were taken from it: it has been cut short")


def _entry(data: bytes, path: Path, number: int) -> Entry:
    try:
        given = json.loads(data)
        cycle = int(given["cycle"])
        if given.get("end"):
            return Entry(cycle=cycle, ends=True)
        if "left_out" in given:
            line = Line(left_out=str(given["left_out"]), count=int(given["count"]))
        else:
            line = Line(str(given["line"]))
        at, offset = float(given["at"]), int(given.get("offset", 0))
        if not abs(at) < LATEST or not 0 <= offset < LARGEST or line.count < 1:
            raise ValueError
        return Entry(line, at, cycle, offset=offset)
    except (ValueError, OverflowError, TypeError, KeyError, AttributeError, RecursionError):
        raise ReadingsError(f"journal {path}, line {number + 1}: expected an entry of a journal") from None


class Journal:
    """Writes a journal; one that is there already is continued, without an entry that was cut off."""

    def __init__(self, path: Path, zero: float | None, client: str = "") -> None:
        self.path = path
        self._stream: BinaryIO
        with self._writing():
            self._stream = path.open("a+b")
            _drop_half_a_line(self._stream)
            if self._stream.tell() == 0:
                self._write({"journal": 1, "zero": zero} | ({"client": client} if client else {}))
                self._stream.flush()
        self._synced = monotonic()

    def note(self, cycle: int, line: Line, at: float, offset: int) -> None:
        """Add a line; it is in the file when this returns."""
        entry: dict[str, Any] = {"cycle": cycle, "at": round(at, 3)}
        entry |= {"left_out": line.left_out, "count": line.count} if line.left_out else {"line": line.text}
        with self._writing():
            self._write(entry | ({"offset": offset} if offset else {}))
            self._stream.flush()

    def end(self, cycle: int) -> None:
        """Add the end of a cycle."""
        with self._writing():
            self._write({"cycle": cycle, "end": True})
            self._stream.flush()
        if monotonic() - self._synced > SYNC_SECONDS:
            self.sync()

    def sync(self) -> None:
        """Write the file to the disk."""
        with self._writing():
            os.fsync(self._stream.fileno())
        self._synced = monotonic()

    def close(self) -> None:
        """Close the file."""
        with self._writing():
            self._stream.close()

    def _write(self, entry: dict[str, Any]) -> None:
        self._stream.write(json.dumps(entry).encode() + b"\n")

    def _writing(self) -> _Writing:
        return _Writing(self.path)


class _Writing:
    """Makes an error of the system one that says that the journal cannot be written: a full disk, say."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, OSError):
            raise RecordError(f"{self.path}: the journal cannot be written ({error.strerror or error})") from error


def _drop_half_a_line(stream: BinaryIO) -> None:
    """Cut off what follows the last line end, and stand at the end."""
    end = stream.seek(0, os.SEEK_END)
    start = max(0, end - LONGEST_ENTRY)
    stream.seek(start)
    tail = stream.read(end - start)
    stream.truncate(start + tail.rfind(b"\n") + 1)
    stream.seek(0, os.SEEK_END)
