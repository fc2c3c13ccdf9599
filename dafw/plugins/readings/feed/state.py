"""What a feed must remember from one cycle to the next, as arrays that a file can hold."""

from __future__ import annotations

import json
from collections import deque
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from dafw.core.ensemble import Memory

RECENT = 20000
"""So many readings are remembered, to know one that comes again."""


@dataclass
class Reading:
    """A reading whose time in the study is known. ``value`` is None where only a sensor's place is told.

    It may be a mean over the ``span`` seconds until its time.
    """

    time: float
    value: float | None
    sd: float | None
    unit: str
    sensor: str
    kind: str
    place: tuple[float, ...]
    span: float = 0.0

    @property
    def key(self) -> tuple[Any, ...]:
        """What is the same in a reading that came twice."""
        return tuple(getattr(self, one.name) for one in fields(self))


@dataclass
class FeedState:
    """Where a feed stands.

    ``entries``: entries of the journal taken. ``offset``: bytes of a file taken. ``zero``: the Unix time of t = 0, None
    while it is not known; ``seconds``: the number of seconds that messages call t = 0, None while that is not known.
    ``until``: up to when all readings have come, ``latest``: the latest time of a reading, both in s. ``ended``:
    whether the feed said that it ends. ``waiting``: readings of later cycles. ``vehicles``: by number, the time and
    place at which a vehicle was last. ``units``: by sensor, the unit that it last told. ``shown``: reasons of which an
    example was logged. ``recent``: digests of readings that came lately.
    """

    entries: int = 0
    offset: int = 0
    zero: float | None = None
    seconds: float | None = None
    until: float = -1e300
    latest: float = -1e300
    ended: bool = False
    waiting: list[Reading] = field(default_factory=list)
    vehicles: dict[int, tuple[float, float, float]] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    shown: list[str] = field(default_factory=list)
    recent: deque[int] = field(default_factory=deque)

    def __post_init__(self) -> None:
        self._known = set(self.recent)

    def is_known(self, digest: int) -> bool:
        """Return whether a reading came before."""
        return digest in self._known

    def remember(self, digest: int) -> None:
        """Remember a reading, and forget the oldest one where there are too many."""
        self.recent.append(digest)
        self._known.add(digest)
        if len(self.recent) > RECENT:
            self._known.discard(self.recent.popleft())

    def memory(self) -> Memory:
        """Return it as arrays."""
        plain = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "recent"}
        plain["waiting"] = [asdict(reading) for reading in self.waiting]
        packed = np.frombuffer(json.dumps(plain).encode(), dtype=np.uint8)
        return {"feed": packed, "recent": np.array(self.recent, dtype=np.uint64)}

    @classmethod
    def of(cls, memory: Memory | None) -> FeedState:
        """Return what ``memory`` packed."""
        if memory is None:
            return cls()
        plain = json.loads(np.asarray(memory["feed"], dtype=np.uint8).tobytes())
        plain["waiting"] = [Reading(**{**one, "place": tuple(one["place"])}) for one in plain["waiting"]]
        plain["vehicles"] = {int(number): tuple(seen) for number, seen in plain["vehicles"].items()}
        return cls(**plain, recent=deque(np.asarray(memory["recent"]).tolist()))
