"""Executor ``serial``: the members one after the other, in this process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from dafw.core.executors import Executor
from dafw.core.executors.batches import Batch, Stepped, step_members
from dafw.core.interfaces.model import Model


@dataclass
class Serial(Executor):
    """In this process; nothing to configure."""

    def begin(self, model: Model, batches: Sequence[Batch]) -> Callable[[], Sequence[Stepped]]:
        """Do the model's own steps; return a function that gives them."""
        stepped = [step_members(model, batch) for batch in batches]
        return lambda: stepped
