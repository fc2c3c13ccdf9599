"""Where members are stepped: in this process, in worker processes, on a dask cluster.

An executor stands between whoever wants members stepped (the cycle, a re-run) and ``Model.step_with_memory``. The
members are cut into contiguous batches, every batch has its members' own random streams and memory, and what comes
back is put together in member order: the bits are the same whichever executor it was and however many workers it had.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any, Self

from dafw.core.executors.batches import Batch, Stepped, join, split
from dafw.core.interfaces.model import Model
from dafw.core.plugin import Plugin


class Executor(Plugin):
    """Steps the members of an ensemble. Authors define ``begin``, and where they need them the rest.

    ``start`` before the first step, ``close`` after the last; as a context it closes itself.
    """

    kind = "executor"

    def start(self, model: Model, config: Mapping[str, Any] | None) -> None:
        """Make ready to step ``model``, which the registry can make anew from ``config``.

        ``config`` is None for a model that was made in Python and that no registry knows: an executor that cannot
        step such a model raises ConfigurationError.
        """

    def width(self) -> int:
        """Return into how many batches an ensemble is cut."""
        return 1

    def begin(self, model: Model, batches: Sequence[Batch]) -> Callable[[], Sequence[Stepped]]:
        """Begin to step the batches; calling what comes back waits for all of them and gives them in order.

        Several may be under way at once, waited for in any order, or never. The call raises what the model raises,
        and ComputationError where workers are lost again and again.
        """
        raise NotImplementedError(f"{self.label} must define begin(model, batches)")

    def submit(self, model: Model, batch: Batch) -> Callable[[], Stepped]:
        """Begin to step all members of ``batch``; calling what comes back waits for them and gives them."""
        width = self.width()
        batches = [batch] if width == 1 else split(model, batch, width)
        stepped = self.begin(model, batches)
        return lambda: join(model, batches, stepped())

    def copies(self) -> int:
        """Return how often the members are held on this machine besides in the process that runs the study.

        A worker process holds its batch as it came, as it was stepped and as it goes back.
        """
        return 0

    def close(self) -> None:
        """End whatever ``start`` began."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
