"""Executor ``serial``: the members one after the other, in this process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from dafw.core.executors import Executor
from dafw.core.executors.batches import Batch, Stepped, step_members
from dafw.core.interfaces.model import Model


@dataclass
class Serial(Executor):
    """Steps the members in this process; has no options."""

    def submit(self, model: Model, batch: Batch) -> Callable[[], Stepped]:
        """Step the members at once; return a function that returns the result."""
        stepped = step_members(model, batch)
        return lambda: stepped
