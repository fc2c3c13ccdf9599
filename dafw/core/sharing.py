"""What the models of one run have in common, so that it is made once and held once.

The truth, the free run and the belief often are the same plugin with almost the same options. They can share a mesh, a
wind solver with its matrices, a reduced basis. ``Study.prepare`` makes one ``Shared`` for a run and hands it to the
models (``Model.share_with``). It is freed with them, so nothing passes from one run of a process to the next. A model
that is used alone has a ``Shared`` of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any


class Shared:
    """The things that the models of one run share, by name."""

    def __init__(self) -> None:
        self._things: dict[Hashable, Any] = {}

    def once[T](self, name: Hashable, make: Callable[[], T]) -> T:
        """Return the thing of that name; ``make()`` makes it the first time.

        The name must say everything that the thing depends on, and no result may depend on who else uses it.
        """
        if name not in self._things:
            self._things[name] = make()
        found: T = self._things[name]
        return found
