"""Executor ``serial``: the members one after the other, in this process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from dafw.core.ensemble import Memory, Step
from dafw.core.executors import Executor
from dafw.core.interfaces import Model
from dafw.core.rng import MemberStreams
from dafw.core.space import Array


@dataclass
class Serial(Executor):
    """In this process; nothing to configure."""

    name = "serial"

    def submit(
        self, model: Model, members: Array, memory: Memory | None, t: float, rng: MemberStreams
    ) -> Callable[[], Step]:
        """Do the model's own step; return a function that gives it."""
        step = model.step_with_memory(members, memory, t, rng)
        return lambda: step
