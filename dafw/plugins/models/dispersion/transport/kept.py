"""Systems of the transport that are kept, looked up by what they are made from."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from hashlib import sha256

import numpy as np


class KeptSystems[System]:
    """The systems used last, by the bits of wind and diffusion: members with the same parameters share one.

    Whether a system is kept or made anew changes the time of a step, never its result. The one that was not used for
    the longest time is made over when another wind needs its place.

    Attributes:
        limit: how many systems are kept.
    """

    def __init__(self) -> None:
        self.limit = 1
        self._systems: OrderedDict[bytes, System] = OrderedDict()

    def __len__(self) -> int:
        return len(self._systems)

    def get(self, parameters: np.ndarray, make: Callable[[System | None], System]) -> System:
        """Return the system of some parameters; make it if it is not kept.

        Args:
            parameters: (k,) numbers that define the system.
            make: makes the system; it is given one that is no longer needed, to be made over, or None.
        """
        key = sha256(parameters.tobytes()).digest()
        found = self._systems.get(key)
        if found is None:
            oldest = None
            while len(self._systems) >= self.limit:  # it is no longer valid, even if making it over fails
                oldest = self._systems.popitem(last=False)[1]
            self._systems[key] = found = make(oldest)
        else:
            self._systems.move_to_end(key)
        return found
