"""The lines of a run, one at a time: first those that its journal has and its state has not taken, then new ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from time import monotonic, time

from dafw.plugins.readings.feed.channels import Channel
from dafw.plugins.readings.feed.journal import FILE, Entry, Journal, entries_of, zero_of
from dafw.plugins.readings.feed.lines import Line
from dafw.plugins.readings.feed.mqtt import Broker
from dafw.plugins.readings.feed.state import FeedState


class Clock:
    """The Unix time, which here never jumps: the machine's clock is asked once."""

    def __init__(self) -> None:
        self._unix, self._since = time(), monotonic()

    def __call__(self) -> float:
        """Return the Unix time in seconds."""
        return self._unix + monotonic() - self._since


class Replayed:
    """A journal as a channel: its entries say in which cycle a line came. It does not grow."""

    def __init__(self, path: Path, entries: int) -> None:
        self.offset, self.ended = 0, False
        self._entries = entries_of(path, entries)

    def entry(self) -> Entry | None:
        """Return the next entry; None at the end."""
        found = next(self._entries, None)
        self.ended = found is None
        return found

    def next(self, seconds: float) -> Line | None:
        """Return nothing: a journal has entries."""
        return None

    def close(self) -> None:
        """Close the file."""


class Feed:
    """What brings the lines of a run; ``connect`` opens the channel, which is given the place to read a file from."""

    def __init__(
        self, connect: Callable[[FeedState], Channel], state: FeedState, folder: Path | None, zero: float | None
    ) -> None:
        self.clock = Clock()
        self._tail: Iterator[Entry] = iter(())
        self._journal: Journal | None = None
        self._channel: Channel | None = None
        self._connect = connect
        if folder is not None:
            path = folder / FILE
            if path.exists() and zero_of(path)[0]:
                self._tail = entries_of(path, state.entries)
            self._journal = Journal(path, zero)
        self._ahead = next(self._tail, None)

    @property
    def ended(self) -> bool:
        """Whether no more lines can come."""
        return self._channel is not None and self._channel.ended

    def next(self, seconds: float, cycle: int, state: FeedState) -> Entry | None:
        """Return the next entry, waiting at most so many seconds for it; None if there is none."""
        if self._ahead is not None:
            found, self._ahead = self._ahead, next(self._tail, None)
            state.entries += 1
            state.offset = found.offset or state.offset
            return replace(found, own=True)
        if self._channel is None:
            self._channel = self._connect(state)
        if isinstance(self._channel, Replayed):
            replayed = self._channel.entry()
            if replayed is None or replayed.ends:
                return replayed  # end_cycle counts it
            entry = replayed
        else:
            line = self._channel.next(seconds)
            if line is None:
                return None
            entry = Entry(line, self.clock(), cycle, offset=self._channel.offset)
        state.entries += 1
        state.offset = entry.offset
        if self._journal is not None:
            self._journal.note(cycle, entry.line, entry.at, entry.offset)
        return entry

    def end_cycle(self, cycle: int, state: FeedState) -> None:
        """Note that a cycle has its readings; not called where an entry of the run's own journal said so."""
        state.entries += 1
        if self._journal is not None:
            self._journal.end(cycle)

    def tells_ends(self, state: FeedState) -> bool:
        """Return whether the next entry is one of a journal, which says when a cycle ends."""
        if self._ahead is None and self._channel is None:
            self._channel = self._connect(state)
        return self._ahead is not None or (isinstance(self._channel, Replayed) and not self._channel.ended)

    def close(self) -> None:
        """Close the journal, and the channel but for a broker, to which advice is still sent."""
        if self._channel is not None and not isinstance(self._channel, Broker):
            self._channel.close()
        if self._journal is not None:
            self._journal.close()
