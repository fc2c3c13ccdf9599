"""Where members are stepped: in this process, in worker processes, on a dask cluster.

The cycle and re-runs call an executor, and the executor calls ``Model.step_with_memory``. It cuts the members into
contiguous batches. Every batch has its members' own random streams and memory, and the results are put together in
member order. So the bits do not depend on the executor or on the number of workers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any, Self

from dafw.core.executors.batches import Batch, Stepped, join, split
from dafw.core.interfaces.model import Model
from dafw.core.plugin import Plugin


class Executor(Plugin):
    """Steps the members of an ensemble. Authors define ``begin``, and the other methods if they need them.

    ``start`` is called before the first step, ``close`` after the last; a ``with`` block closes the executor.
    """

    kind = "executor"

    def start(self, model: Model, config: Mapping[str, Any] | None) -> None:
        """Prepare to step ``model``, which the registry can make again from ``config``.

        ``config`` is None for a model that was made in Python and is not registered. An executor that cannot step
        such a model raises ConfigurationError.
        """

    def width(self) -> int:
        """Return into how many batches an ensemble is cut."""
        return 1

    def begin(self, model: Model, batches: Sequence[Batch]) -> Callable[[], Sequence[Stepped]]:
        """Start stepping the batches; return a function that waits for them and returns the results in order.

        Several calls may be under way at once; their results may be fetched in any order, or never. The returned
        function raises what the model raises, and ComputationError if workers are lost repeatedly.
        """
        raise NotImplementedError(f"{self.label} must define begin(model, batches)")

    def submit(self, model: Model, batch: Batch) -> Callable[[], Stepped]:
        """Start stepping all members of ``batch``; return a function that waits for them and returns the result."""
        width = self.width()
        batches = [batch] if width == 1 else split(model, batch, width)
        stepped = self.begin(model, batches)
        return lambda: join(model, batches, stepped())

    def copies(self) -> int:
        """Return how many copies of the members this machine holds outside the process that runs the study.

        A worker process holds its batch three times: as received, as stepped and as sent back.
        """
        return 0

    def close(self) -> None:
        """Release everything that ``start`` acquired, such as worker processes."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
