"""The inbox of a run that hears a broker: a file with what came and is not in the journal of the run yet.

A broker forgets a message when its receipt is confirmed. So its lines are in this file before that, and a run that is
killed while they wait finds them here. The first line of the file is a JSON object, the others are what came:

    {"inbox": 1, "begins": 0, "client": "..."}

Places in it are counted from the first line that the run ever got, in bytes, as the ``offset`` of entries of the
journal; ``begins`` is that of the file's first one. When all lines have been taken and the file is larger than LARGE,
it is begun anew. ``client`` is the name by which the broker knows the run.
"""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from dafw.core.errors import ReadingsError, RecordError
from dafw.core.files import write_atomically
from dafw.plugins.readings.feed.lines import Line, Splitter, line_of
from dafw.plugins.readings.feed.messages import LONGEST

FILE = "inbox.jsonl"
LARGE = 1 << 20
"""Bytes of lines that were taken, from which the file is begun anew."""
RECENT = 20
"""Messages that are remembered, to know one that the broker sends again: it waits for so many receipts at once."""
HEAD = 1000
"""Bytes that the first line may have."""
CHUNK = 1 << 16
TOO_LONG = b"x" * (LONGEST + 1)
"""Stands in the file for any line that is too long."""


@dataclass(frozen=True)
class Head:
    """The first line of an inbox: how many bytes it has, where its lines begin, and the run's name at its broker."""

    size: int
    begins: int
    client: str


def head_of(path: Path) -> Head | None:
    """Return the first line of an inbox, None if there is no file; raises ReadingsError if the file is none."""
    try:
        with path.open("rb") as stream:
            first = stream.readline(HEAD)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ReadingsError(f"{path}: cannot be read ({error.strerror or error})") from None
    try:
        told = json.loads(first)
        if told["inbox"] != 1 or not isinstance(told["begins"], int) or not 0 <= told["begins"] < 2**62:
            raise ValueError
        return Head(len(first), told["begins"], str(told["client"]))
    except (ValueError, LookupError, TypeError, RecursionError):
        raise ReadingsError(f"{path}: expected the inbox of a run, got another file") from None


class Inbox:
    """Appends what comes. ``taken`` is how far the lines of an inbox that is there already are in the journal.

    ``waiting`` are its other lines. Raises ReadingsError for a file that is no inbox, RecordError if it cannot be
    written.
    """

    def __init__(self, path: Path, taken: int, client: str) -> None:
        self.path, self._client = path, client
        self.waiting: list[Line] = []
        self._begins = self._end = taken
        self._stream = -1
        # The number of a message, None from before a kill, and the hash of its lines, which may be long.
        self._recent: deque[tuple[int | None, int]] = deque(maxlen=RECENT)
        head = head_of(path)
        if head is not None:
            self.waiting = self._read(head, taken)
        if self.waiting:
            self._stream = os.open(path, os.O_WRONLY | os.O_APPEND)
        else:
            self._begin()

    def _read(self, head: Head, taken: int) -> list[Line]:
        """Return the lines that wait, and cut off a line that was being written when the run was killed."""
        splitter, found, size, whole = Splitter(head.begins), [], head.size, head.size
        with self.path.open("rb") as stream:
            stream.seek(head.size)
            while data := stream.read(CHUNK):
                lines = splitter.feed(data)
                self._recent.extend((None, hash((line.text,))) for line in lines)
                found += [line for line in lines if line.end > taken]
                size += len(data)
                whole = size - len(data) + data.rfind(b"\n") + 1 if b"\n" in data else whole
        os.truncate(self.path, whole)
        self._begins, self._end = head.begins, head.begins + whole - head.size
        if self._end < taken:  # it is not the one that the journal was written from
            self._begins = self._end = taken
        return found

    def _begin(self) -> None:
        """Begin the file anew, without lines."""
        if self._stream >= 0:
            os.close(self._stream)
            self._stream = -1
        self._begins = self._end
        told = {"inbox": 1, "begins": self._begins, "client": self._client}
        try:
            write_atomically(self.path, json.dumps(told) + "\n")
            self._stream = os.open(self.path, os.O_WRONLY | os.O_APPEND)
        except OSError as error:
            raise self._unwritable(error) from error

    def _unwritable(self, error: OSError) -> RecordError:
        return RecordError(f"{self.path}: cannot be written ({error.strerror or error})")

    def put(self, parts: Iterable[bytes], message: int = 0) -> list[Line]:
        """Append the lines of a ``message``, and return them; they are in the file then. Raises RecordError."""
        found, data = [], bytearray()
        for part in parts:
            data += (part if len(part) <= LONGEST else TOO_LONG) + b"\n"
            found.append(line_of(part, self._end + len(data)))
        try:
            written = os.write(self._stream, data)
            if written < len(data):  # the disk is full
                os.ftruncate(self._stream, os.fstat(self._stream).st_size - written)
                raise OSError(f"{written} of {len(data)} bytes were written")
        except OSError as error:
            raise self._unwritable(error) from error
        self._end += len(data)
        self._recent.append((message, _hash_of(found)))
        return found

    def had(self, parts: Iterable[bytes], message: int) -> bool:
        """Return whether a ``message`` with these lines came a short time ago; it is not taken for another one then.

        What came before a kill has no number, so its lines alone are compared.
        """
        lines = _hash_of([line_of(part) for part in parts])
        for known in ((message, lines), (None, lines)):
            if known in self._recent:
                self._recent.remove(known)
                return True
        return False

    def all_taken(self) -> None:
        """Begin the file anew if it is large; called when all lines are in the journal. Raises RecordError."""
        if self._end - self._begins > LARGE:
            self._begin()

    def close(self, *, empty: bool) -> None:
        """Close the file, and remove it if it is ``empty``: all lines are in the journal."""
        if self._stream >= 0:
            os.close(self._stream)
            self._stream = -1
        if empty:
            with suppress(OSError):
                self.path.unlink()


def _hash_of(lines: Iterable[Line]) -> int:
    return hash(tuple(line.text for line in lines))
