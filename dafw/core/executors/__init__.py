"""Where the members of the belief are stepped: in this process, in worker processes, on a dask cluster.

An executor stands between the cycle and ``Model.step_with_memory``. The members are cut into contiguous batches, every
batch has its members' own random streams and memory, and what comes back is put together in member order: the bits
are the same whichever executor it was and however many workers it had.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, ClassVar, Self

from dafw.core.ensemble import Memory, Step
from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Model
from dafw.core.options import build
from dafw.core.rng import MemberStreams
from dafw.core.space import Array


class Executor:
    """Steps the members of an ensemble; its dataclass fields are its options.

    ``start`` before the first step, ``close`` after the last; as a context it closes itself.
    """

    name: ClassVar[str]

    @property
    def label(self) -> str:
        """The executor as messages name it: ``executor 'processes'``."""
        return f"executor '{self.name}'"

    def start(self, model: Model, config: Mapping[str, Any]) -> None:
        """Make ready to step ``model``, which the registry made from ``config``."""

    def submit(
        self, model: Model, members: Array, memory: Memory | None, t: float, rng: MemberStreams
    ) -> Callable[[], Step]:
        """Begin a step of the members (N, n) at t seconds; calling what comes back waits for it and gives it.

        The call raises what the model raises, and ComputationError where workers are lost again and again.
        """
        raise NotImplementedError(f"{self.label} must define submit(model, members, memory, t, rng)")

    def step(self, model: Model, members: Array, memory: Memory | None, t: float, rng: MemberStreams) -> Step:
        """Step the members (N, n) and wait."""
        return self.submit(model, members, memory, t, rng)()

    def close(self) -> None:
        """End whatever ``start`` began."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


EXECUTORS = {
    "serial": "dafw.core.executors.serial:Serial",
    "processes": "dafw.core.executors.processes:Processes",
    "dask": "dafw.core.executors.dask_cluster:Dask",
}


def executor_class(name: object) -> type[Executor]:
    """Return the class of an executor; raises ConfigurationError where there is none of this name."""
    if not isinstance(name, str) or name not in EXECUTORS:
        raise ConfigurationError(f"there is no executor '{name}' (there are: {', '.join(EXECUTORS)})")
    module, _, attribute = EXECUTORS[name].partition(":")
    found: type[Executor] = getattr(importlib.import_module(module), attribute)
    return found


def make_executor(config: Mapping[str, Any]) -> Executor:
    """Make an executor from its ``name`` and options, nothing started; raises ConfigurationError."""
    options = dict(config)
    cls = executor_class(options.pop("name", None))
    return build(cls, options, f"executor '{cls.name}'")
