"""Cutting an ensemble into batches of neighbouring members, stepping a batch, and putting the batches together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from dafw.core.ensemble import Diagnostic, Diagnostics, Ensemble, Memory, Step
from dafw.core.errors import ContractError, DafwError
from dafw.core.interfaces.model import Model
from dafw.core.observation import ObservationOperator
from dafw.core.rng import MemberStreams
from dafw.core.space import Array


@dataclass(frozen=True, eq=False)
class Batch:
    """Everything needed to step a group of neighbouring members, independently of all other members.

    ``members`` (k, n) start at ``t`` seconds with the model's ``memory`` and are stepped ``n_steps`` times, with the
    streams ``rng`` of the first step and those of the cycles after it. ``operators`` are keyed by the number of steps
    (1 ... n_steps) after which they are applied. ``keep``: return the members after every step, not only the last.
    ``first`` is the number of the first member.
    """

    members: Array
    memory: Memory | None
    t: float
    rng: MemberStreams
    n_steps: int = 1
    operators: Mapping[int, ObservationOperator] = field(default_factory=dict)
    keep: bool = False
    first: int = 0

    @property
    def title(self) -> str:
        """The members as messages name them: ``members 4 to 7``."""
        last = self.first + len(self.members) - 1
        return f"member {last}" if last == self.first else f"members {self.first} to {last}"


@dataclass(frozen=True, eq=False)
class Stepped:
    """The result of a batch: its last step, or all if kept; ``predicted`` (k, m) keyed by the number of steps."""

    steps: tuple[Step, ...]
    predicted: Mapping[int, Array] = field(default_factory=dict)


def step_members(model: Model, batch: Batch) -> Stepped:
    """Step a batch with a model in this process. All steps but the last are checked.

    Raises what the model raises; an error about a member counts it in the whole ensemble.
    """
    try:
        return _stepped(model, batch)
    except DafwError as error:
        if error.member is not None:
            error.member += batch.first
        raise


def _stepped(model: Model, batch: Batch) -> Stepped:
    if batch.n_steps == 1 and not batch.operators:
        return Stepped((model.step_with_memory(batch.members, batch.memory, batch.t, batch.rng),))
    steps: list[Step] = []
    predicted: dict[int, Array] = {}
    ensemble, memory = Ensemble(batch.members, model.space, batch.t), batch.memory
    number = 0
    while number < batch.n_steps:
        rng, left = batch.rng.later(number), batch.n_steps - number
        several = model.steps_with_memory(ensemble.members, memory, ensemble.time, rng, left)
        if not 1 <= len(several) <= left:
            raise ContractError(f"{model.label}: steps_with_memory must return 1 to {left} steps, got {len(several)}")
        for step in several:
            number += 1
            forecast = model.stepped(ensemble, step)
            ensemble, memory = forecast.ensemble, forecast.memory
            if number in batch.operators:
                predicted[number] = batch.operators[number].apply(ensemble.members)
            if batch.keep or number == batch.n_steps:
                steps.append(Step(ensemble.members, memory, forecast.diagnostics))
    return Stepped(tuple(steps), predicted)


def split(model: Model, batch: Batch, count: int) -> list[Batch]:
    """Split a batch into at most ``count`` batches whose sizes differ by at most one.

    Raises ContractError if the model's memory cannot be split.
    """
    n_members = len(batch.members)
    for name, array in (batch.memory or {}).items():
        if np.ndim(array) == 0 or len(array) != n_members:
            raise ContractError(
                f"{model.label}: its memory must have the {n_members} members on axis 0, got the shape "
                f"{np.shape(array)} for '{name}'"
            )
    if min(count, n_members) <= 1:
        return [batch]
    bounds = np.linspace(0, n_members, min(count, n_members) + 1).astype(int).tolist()
    batches = []
    for first, last in pairwise(bounds):
        part = None if batch.memory is None else {name: array[first:last] for name, array in batch.memory.items()}
        members, rng = batch.members[first:last], batch.rng.shifted(first)
        batches.append(Batch(members, part, batch.t, rng, batch.n_steps, batch.operators, batch.keep, first))
    return batches


def join(model: Model, batches: Sequence[Batch], stepped: Sequence[Stepped]) -> Stepped:
    """Concatenate the results of the batches in member order.

    Diagnostics and memory with a member axis are concatenated; everything else must be the same in all batches,
    otherwise ContractError is raised.
    """
    if len(stepped) == 1:
        return stepped[0]
    steps = [_joined_steps(model, batches, parts) for parts in zip(*(one.steps for one in stepped), strict=True)]
    predicted = {number: np.concatenate([one.predicted[number] for one in stepped]) for number in stepped[0].predicted}
    return Stepped(tuple(steps), predicted)


def _joined_steps(model: Model, batches: Sequence[Batch], steps: Sequence[Step]) -> Step:
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
