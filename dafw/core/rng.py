"""Random numbers: one seed gives every role, cycle and member a stream of its own.

Philox is counter-based: a stream is addressed, not advanced. The key is made of the seed and the role, the counter of
the cycle and the member. So a run that is continued needs no generator state, two policies meet the same noise, and a
larger ensemble leaves the draws of the members that were there before as they were.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from zlib import crc32

import numpy as np
from numpy.random.bit_generator import ISeedSequence

from dafw.core.space import Array


class _Key(ISeedSequence):
    """A key for Philox, handed over as a seed.

    ``Philox(key=...)`` means the same, but asks the operating system for entropy all the same: a stream takes 7 to 12
    microseconds instead of 2 to 4. A cycle of Lorenz-96 (300 microseconds) opens 3 of them, one of the flagship 13.
    """

    def __init__(self, words: np.ndarray) -> None:
        self._words = words

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> np.ndarray:
        """Return the key, which is what Philox asks for."""
        return self._words


class Streams:
    """All random streams of a run with this seed."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self._keys: dict[str, Any] = {}  # numpy's stubs do not know that any ISeedSequence will do

    def __reduce__(self) -> tuple[type[Streams], tuple[int]]:
        """Travel as the seed: it gives the same streams anywhere."""
        return Streams, (self.seed,)

    def generator(self, role: str, cycle: int, member: int = 0) -> np.random.Generator:
        """Return the generator of a role ("policy", "observation noise", ...) at a cycle, for one member."""
        if role not in self._keys:
            sequence = np.random.SeedSequence([self.seed, crc32(role.encode())])
            self._keys[role] = _Key(sequence.generate_state(2, np.uint64))
        # The low words count the draws, so that streams of neighbours never meet.
        return np.random.Generator(np.random.Philox(self._keys[role], counter=[0, 0, member, cycle]))

    def members(self, role: str, cycle: int) -> MemberStreams:
        """Return the generators of a role at a cycle, one for each member."""
        return MemberStreams(self, role, cycle)


class MemberStreams:
    """One generator for each member, made when asked for: ``rng[i]``."""

    def __init__(self, streams: Streams, role: str, cycle: int, first: int = 0) -> None:
        self._streams, self._role, self._cycle, self._first = streams, role, cycle, first

    def __getitem__(self, member: int) -> np.random.Generator:
        if member < 0:
            raise IndexError("members are counted from 0")
        return self._streams.generator(self._role, self._cycle, self._first + member)

    def shifted(self, first: int) -> MemberStreams:
        """Return the streams as seen by a batch of members that begins at ``first``."""
        return MemberStreams(self._streams, self._role, self._cycle, self._first + first)

    def later(self, n_cycles: int) -> MemberStreams:
        """Return the streams of the same role and members ``n_cycles`` cycles later."""
        return MemberStreams(self._streams, self._role, self._cycle + n_cycles, self._first)

    def draw(self, n_members: int, one: Callable[[np.random.Generator], Array]) -> Array:
        """Return ``one(generator)`` of every member, stacked on axis 0."""
        return np.stack([np.asarray(one(self[member])) for member in range(n_members)])

    def standard_normal(self, shape: int | tuple[int, ...]) -> Array:
        """Return standard normal numbers of ``shape`` N or (N, ...): row i is drawn from member i's own stream."""
        shape = (shape,) if isinstance(shape, int) else shape
        return self.draw(shape[0], lambda generator: generator.standard_normal(shape[1:]))
