"""The step between a vector over the full mesh and the entries that one MPI rank holds of it.

Vectors over the full mesh are numbered as in one process, however many ranks the mesh is divided among.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dafw.core.errors import ComputationError


@dataclass(frozen=True)
class Undivided:
    """The partition of one process, which holds all ``size`` entries of a vector."""

    size: int

    def local(self, full: np.ndarray) -> np.ndarray:
        """Return ``full``."""
        return full

    def gather(self, local: np.ndarray) -> np.ndarray:
        """Return ``local``."""
        return local


class Partition:
    """The partition of several ranks.

    Attributes:
        size: number of entries of a vector over the full mesh.
    """

    def __init__(self, places: np.ndarray, communicator: Any):
        """Exchange the places of all ranks; a collective call.

        Args:
            places: (n,) index in the full vector of every entry that this rank holds.
            communicator: the MPI communicator of the ranks.

        Raises ComputationError unless every entry of the full vector is held by exactly one rank.
        """
        self._places, self._communicator = places, communicator
        parts = communicator.allgather(places)
        self._counts, self._all = [len(part) for part in parts], np.concatenate(parts)
        self.size: int = len(self._all)
        if not np.array_equal(np.sort(self._all), np.arange(self.size)):
            raise ComputationError(
                f"the mesh is divided among {len(parts)} ranks: expected each of its {self.size} unknowns on exactly "
                "one of them, got some on several or on none"
            )

    def local(self, full: np.ndarray) -> np.ndarray:
        """Return this rank's entries (n,) of a full vector (size,)."""
        return full[self._places]

    def gather(self, local: np.ndarray) -> np.ndarray:
        """Return the full vector (size,), the same on all ranks, from every rank's entries (n,); a collective call."""
        gathered = np.empty(self.size)
        self._communicator.Allgatherv(local, (gathered, self._counts))
        full = np.empty(self.size)
        full[self._all] = gathered
        return full
