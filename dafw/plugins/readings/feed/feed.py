"""The lines of a run, one at a time: first those that its journal has and its state has not taken, then new ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from time import monotonic, time

from dafw.core.errors import ReadingsError
from dafw.plugins.readings.feed.channels import Channel
from dafw.plugins.readings.feed.journal import FILE, Entry, Journal, entries_of, head_of
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
    """What brings the lines of a run; ``connect`` opens the channel, which is given the place to read a file from.

    ``client`` is the name by which a broker knows the run. Raises ReadingsError if the journal lacks what ``state`` has
    taken.
    """

    def __init__(
        self,
        connect: Callable[[FeedState], Channel],
        state: FeedState,
        folder: Path | None,
        zero: float | None,
        client: str = "",
    ) -> None:
        self.clock = Clock()
        self._tail: Iterator[Entry] = iter(())
        self._journal: Journal | None = None
        self._channel: Channel | None = None
        self._connect = connect
        if folder is not None:
            path = folder / FILE
            if head_of(path) is not None:
                self._tail = entries_of(path, state.entries)
            elif state.entries:
                raise ReadingsError(f"{path}: is no journal, and {state.entries} entries were taken from one")
        # Before the journal is opened to be written: this raises if it was cut short.
        self._ahead = next(self._tail, None)
        if folder is not None:
            self._journal = Journal(folder / FILE, zero, client)

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
            at = round(self.clock(), 3)  # as the journal has it: a reading without a time has this one
            entry = Entry(line, at, cycle, offset=self._channel.offset)
        self._note(entry, cycle, state)
        return entry

    def say_end(self, cycle: int, state: FeedState) -> None:
        """Note that no more lines will come, as if a message had said so: a run that goes on does not ask again."""
        self._note(Entry(Line('{"end": true}'), round(self.clock(), 3), cycle, offset=state.offset), cycle, state)
        state.ended = True

    def _note(self, entry: Entry, cycle: int, state: FeedState) -> None:
        state.entries += 1
        state.offset = entry.offset
        if self._journal is not None:
            self._journal.note(cycle, entry.line, entry.at, entry.offset)

    def end_cycle(self, cycle: int, state: FeedState) -> None:
        """Note that a cycle has its readings; not called where an entry of the run's own journal said so."""
        state.entries += 1
        if self._journal is not None:
            self._journal.end(cycle)

    def tells_ends(self, state: FeedState) -> bool:
        """Return whether the next entry is one of a journal, which says when a cycle ends."""
        if self._ahead is None and self._channel is None and not state.ended:
            self._channel = self._connect(state)
        return self._ahead is not None or (isinstance(self._channel, Replayed) and not self._channel.ended)

    def settle(self) -> None:
        """Write the journal to the disk; raises RecordError."""
        if self._journal is not None:
            self._journal.sync()

    def close(self) -> None:
        """Close the journal, and the channel but for a broker, to which advice is still sent."""
        if self._channel is not None and not isinstance(self._channel, Broker):
            self._channel.close()
        if self._journal is not None:
            self._journal.close()
