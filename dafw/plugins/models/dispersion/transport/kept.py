"""Systems of the transport that are kept, looked up by what they are made from."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from hashlib import sha256
from threading import Lock

import numpy as np


class Place[System]:
    """The place of one system, which is made when it is first asked for; several threads may ask."""

    def __init__(self, old: System | None) -> None:
        """Prepare the place; ``old`` is a system that is no longer needed."""
        self._old: System | None = old
        self._system: System | None = None
        self._lock = Lock()

    def system(self, make: Callable[[System | None], System]) -> System:
        """Return the system; ``make`` makes it, and is given one that is no longer needed, to be made over, or None."""
        with self._lock:
            if self._system is None:
                old, self._old = self._old, None  # it is no longer valid, even if making it over fails
                self._system = make(old)
            return self._system

    def given_up(self) -> System | None:
        """Return the system or the old one, which the place then no longer has."""
        with self._lock:
            found, self._old, self._system = self._system or self._old, None, None
            return found


class KeptSystems[System]:
    """The systems used last, by the bits of wind and diffusion: members with the same parameters share one.

    Whether a system is kept or made anew changes the time of a step, never its result. The one that was not used for
    the longest time is made over when another wind needs its place.

    Attributes:
        limit: how many systems are kept. So many places at a time can be used side by side.
    """

    def __init__(self) -> None:
        self.limit = 1
        self._places: OrderedDict[bytes, Place[System]] = OrderedDict()

    def __len__(self) -> int:
        return len(self._places)

    def place(self, parameters: np.ndarray) -> Place[System]:
        """Return the place of the system of some parameters (k,), numbers that define it."""
        key = sha256(parameters.tobytes()).digest()
        found = self._places.get(key)
        if found is None:
            oldest = None
            while len(self._places) >= self.limit:
                oldest = self._places.popitem(last=False)[1]
            self._places[key] = found = Place(oldest.given_up() if oldest else None)
        else:
            self._places.move_to_end(key)
        return found
