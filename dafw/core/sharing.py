"""What the models of one run have in common, so that it is found once and held once.

The truth, the free run and the belief often are the same plugin with almost the same options: they share a wind solver,
its matrices and its reduced basis. A place to keep such things belongs to one run and goes with its models: the next
run of the same process begins with nothing, and looks for itself what there is by then.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any


class Shared:
    """Things by what defines them; ``things.once(name, make)`` makes one where it is not there yet."""

    def __init__(self) -> None:
        self._things: dict[Hashable, Any] = {}

    def once[T](self, name: Hashable, make: Callable[[], T]) -> T:
        """Return the thing of a name that says all that it depends on; no result may depend on who else uses it."""
        if name not in self._things:
            self._things[name] = make()
        found: T = self._things[name]
        return found


_TOGETHER: ContextVar[Shared | None] = ContextVar("together", default=None)


@contextmanager
def together() -> Iterator[None]:
    """Give all plugins that are made inside one place for what they share."""
    token = _TOGETHER.set(Shared())
    try:
        yield
    finally:
        _TOGETHER.reset(token)


def shared() -> Shared:
    """Return the place of the plugins that are being made together; one of its own for a plugin made alone."""
    return _TOGETHER.get() or Shared()
