"""Cutting an ensemble into batches of neighbouring members, and putting the steps of the batches together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from dafw.core.ensemble import Diagnostic, Diagnostics, Memory, Step
from dafw.core.errors import ContractError
from dafw.core.interfaces import Model
from dafw.core.rng import MemberStreams
from dafw.core.space import Array


@dataclass(frozen=True, eq=False)
class Batch:
    """All that a step of some neighbouring members needs: nothing in it knows of the others.

    ``first`` is the number of the first of the members (k, n), ``t`` the time in seconds.
    """

    first: int
    members: Array
    memory: Memory | None
    t: float
    rng: MemberStreams

    @property
    def title(self) -> str:
        """The members as messages name them: ``members 4 to 7``."""
        last = self.first + len(self.members) - 1
        return f"member {last}" if last == self.first else f"members {self.first} to {last}"


def split(model: Model, members: Array, memory: Memory | None, t: float, rng: MemberStreams, count: int) -> list[Batch]:
    """Cut members (N, n) into at most ``count`` batches, in sizes that differ by one at most.

    Raises ContractError where the model's memory cannot be cut.
    """
    n_members = len(members)
    for name, array in (memory or {}).items():
        if np.ndim(array) == 0 or len(array) != n_members:
            raise ContractError(
                f"{model.label}: its memory must have the {n_members} members on axis 0, got the shape "
                f"{np.shape(array)} for '{name}'"
            )
    bounds = np.linspace(0, n_members, min(count, n_members) + 1).astype(int).tolist()
    batches = []
    for first, last in pairwise(bounds):
        part = None if memory is None else {name: array[first:last] for name, array in memory.items()}
        batches.append(Batch(first, members[first:last], part, t, rng.shifted(first)))
    return batches


def join(model: Model, batches: Sequence[Batch], steps: Sequence[Step]) -> Step:
    """Put the steps of the batches together in member order.

    Diagnostics and memory come from the members; raises ContractError where batches disagree on what is not.
    """
    if len(steps) == 1:
        return steps[0]
    stepped = [
        model.checked(step.members, batch.members.shape, f"{batch.title} after a step")
        for batch, step in zip(batches, steps, strict=True)
    ]
    return Step(np.concatenate(stepped), _joined_memory(model, batches, steps), _joined_diagnostics(model, steps))


def _joined_memory(model: Model, batches: Sequence[Batch], steps: Sequence[Step]) -> Memory | None:
    memories = [step.memory for step in steps if step.memory is not None]
    if not memories:
        return None
    if len(memories) < len(steps) or len({tuple(memory) for memory in memories}) > 1:
        raise ContractError(f"{model.label}: steps of some members and of others leave different kinds of memory")
    for batch, memory in zip(batches, memories, strict=True):
        for name, array in memory.items():
            if np.ndim(array) == 0 or len(array) != len(batch.members):
                raise ContractError(
                    f"{model.label}: the memory of {batch.title} must have them on axis 0, got the shape "
                    f"{np.shape(array)} for '{name}'"
                )
    return {name: np.concatenate([memory[name] for memory in memories]) for name in memories[0]}


def _joined_diagnostics(model: Model, steps: Sequence[Step]) -> Diagnostics:
    first = steps[0].diagnostics
    if any(set(step.diagnostics) != set(first) for step in steps):
        raise ContractError(f"{model.label}: steps of some members and of others report different diagnostics")
    return {name: _joined(model, name, [step.diagnostics[name] for step in steps]) for name in first}


def _joined(model: Model, name: str, parts: Sequence[Diagnostic]) -> Diagnostic:
    first = parts[0]
    values = [np.asarray(part.values) for part in parts]
    joined: Any
    if "member" in first.dims:
        joined = np.concatenate(values, axis=first.dims.index("member"))
    elif all(value.tobytes() == values[0].tobytes() for value in values):
        joined = first.values
    else:
        raise ContractError(
            f"{model.label}: the diagnostic '{name}' differs from one batch of members to another: expected the "
            f"dimension 'member', got {first.dims}"
        )
    return Diagnostic(joined, first.dims, first.units, first.long_name)
