"""Random numbers: one seed gives every role, cycle and member a stream of its own.

Philox is counter-based: a stream is addressed, not advanced. The key is made of the seed and the role, the counter of
the cycle and the member. So a run that is continued needs no generator state, two policies get the same noise, and
adding members does not change the draws of the others.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from zlib import crc32

import numpy as np
from numpy.random.bit_generator import ISeedSequence

from dafw.core.space import Array


class _Key(ISeedSequence):
    """A key for Philox, passed as a seed sequence.

    ``Philox(key=...)`` gives the same stream, but also asks the operating system for entropy: making a stream takes 7
    to 12 microseconds instead of 2 to 4. A cycle of Lorenz-96 (300 microseconds) makes 3, one of the flagship 13.
    """

    def __init__(self, words: np.ndarray) -> None:
        self._words = words

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> np.ndarray:
        """Return the key; Philox calls this to get its key."""
        return self._words


class Streams:
    """All random streams of a run with this seed."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self._keys: dict[str, Any] = {}  # numpy's type stubs do not accept every ISeedSequence

    def __reduce__(self) -> tuple[type[Streams], tuple[int]]:
        """Pickle the seed alone: it gives the same streams in every process."""
        return Streams, (self.seed,)

    def generator(self, role: str, cycle: int, member: int = 0) -> np.random.Generator:
        """Return the generator of a role ("policy", "observation noise", ...) at a cycle, for one member."""
        if role not in self._keys:
            sequence = np.random.SeedSequence([self.seed, crc32(role.encode())])
            self._keys[role] = _Key(sequence.generate_state(2, np.uint64))
        # The low words of the counter count the draws, so that no two streams overlap.
        return np.random.Generator(np.random.Philox(self._keys[role], counter=[0, 0, member, cycle]))

    def members(self, role: str, cycle: int) -> MemberStreams:
        """Return the generators of a role at a cycle, one for each member."""
        return MemberStreams(self, role, cycle)


class MemberStreams:
    """One generator for each member, made on access: ``rng[i]``."""

    def __init__(self, streams: Streams, role: str, cycle: int, first: int = 0) -> None:
        self._streams, self._role, self._cycle, self._first = streams, role, cycle, first

    def __getitem__(self, member: int) -> np.random.Generator:
        if member < 0:
            raise IndexError("members are counted from 0")
        return self._streams.generator(self._role, self._cycle, self._first + member)

    def shifted(self, first: int) -> MemberStreams:
        """Return the streams of a batch of members that begins at member ``first``."""
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
