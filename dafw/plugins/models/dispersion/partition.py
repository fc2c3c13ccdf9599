"""From the numbering of the whole mesh, the same however many ranks share it, to a rank's part of it, and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dafw.core.errors import ComputationError


@dataclass(frozen=True)
class Undivided:
    """One rank has it all: the part is the whole, of ``size`` numbers."""

    size: int

    def part(self, whole: np.ndarray) -> np.ndarray:
        """Return ``whole``."""
        return whole

    def whole(self, part: np.ndarray) -> np.ndarray:
        """Return ``part``."""
        return part


class Partition:
    """Several ranks have a part each; ``size`` is that of the whole."""

    def __init__(self, places: np.ndarray, communicator: Any):
        """Take where in the whole this rank's numbers (n,) stand; all ranks of the communicator call together.

        Raises ComputationError where the ranks' places do not make up a whole.
        """
        self._places, self._communicator = places, communicator
        parts = communicator.allgather(places)
        self._counts, self._all = [len(part) for part in parts], np.concatenate(parts)
        self.size: int = len(self._all)
        if not np.array_equal(np.sort(self._all), np.arange(self.size)):
            raise ComputationError(f"the {len(parts)} parts of the mesh do not make up a whole of {self.size} unknowns")

    def part(self, whole: np.ndarray) -> np.ndarray:
        """Return this rank's numbers (n,) of a whole (size,)."""
        return whole[self._places]

    def whole(self, part: np.ndarray) -> np.ndarray:
        """Return the whole (size,), the same on all ranks, which call together with their parts (n,)."""
        gathered = np.empty(self.size)
        self._communicator.Allgatherv(part, (gathered, self._counts))
        whole = np.empty(self.size)
        whole[self._all] = gathered
        return whole


def nearest(points: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return for each of ``places`` (n, d) the number of the one of ``points`` (m, d) that is nearest."""
    from scipy.spatial import KDTree

    found: np.ndarray = KDTree(points).query(places)[1]
    return found
