"""Bytes into lines, however they are cut into pieces, in bounded memory."""

from __future__ import annotations

from dataclasses import dataclass

from dafw.plugins.readings.feed.messages import LONGEST


@dataclass(frozen=True)
class Line:
    """A line that a channel brought.

    ``left_out`` is the reason why it has no text, and ``count`` how many such lines it stands for. ``end`` is the
    number of bytes of its stream up to its end.
    """

    text: str = ""
    left_out: str = ""
    count: int = 1
    end: int = 0


def line_of(data: bytes, end: int = 0) -> Line:
    """Return one line; bytes that are not UTF-8 stay what they are, as lone surrogates."""
    if len(data) > LONGEST:
        return Line(left_out="too_long", end=end)
    return Line(data.decode("utf-8", "surrogateescape"), end=end)


class Splitter:
    """Cuts a stream into lines. Of a line longer than LONGEST nothing is kept but that there was one."""

    def __init__(self, begun: int = 0) -> None:
        self._rest, self._skipped = b"", 0
        self._end = begun  # of the last line

    @property
    def held(self) -> int:
        """How many bytes of an unfinished line are kept."""
        return len(self._rest)

    def feed(self, data: bytes) -> list[Line]:
        """Return the lines that are complete with ``data``, without empty ones."""
        *whole, rest = data.split(b"\n")
        found = []
        for part in whole:
            line, self._rest = self._rest + part, b""
            self._end += self._skipped + len(line) + 1
            if self._skipped:
                found.append(Line(left_out="too_long", end=self._end))
            elif line.strip():
                found.append(line_of(line, self._end))
            self._skipped = 0
        self._rest += rest
        if self._skipped or len(self._rest) > LONGEST:
            self._skipped, self._rest = self._skipped + len(self._rest), b""
        return found

    def finish(self) -> list[Line]:
        """Return the last line of a stream that has ended without a line end."""
        return self.feed(b"\n")
