"""Checks of executors: their results must have the same bits as steps in this process."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dafw.authoring.checks import ConformanceError, Factory, check, require
from dafw.authoring.evidence import require_same_bits
from dafw.core.errors import SolverError, about_member
from dafw.core.executors import Executor
from dafw.core.executors.batches import Batch, Stepped, step_members
from dafw.core.interfaces import Model
from dafw.core.observation import ObservationOperator
from dafw.core.registry import registry
from dafw.core.rng import Streams
from dafw.core.space import Array

MODEL = {"name": "linear_advection", "cells": 6, "length": 6.0, "speed": 0.5, "waves": 2}
MODEL_ERROR = {"error_sd": 0.1, "error_correlation": 0.6}


@dataclass(frozen=True, eq=False, kw_only=True)
class Sums(ObservationOperator):
    """Reads the sum and the first entry of a state."""

    def apply(self, members: Array) -> Array:
        """Return the readings (N, 2)."""
        return np.stack([members.sum(axis=1), members[:, 0]], axis=1)


@dataclass(frozen=True, eq=False, kw_only=True)
class Refuses(ObservationOperator):
    """Cannot read a state whose first entry is above 1000."""

    def apply(self, members: Array) -> Array:
        """Return the first entry (N, 1); raises SolverError, which names the member."""
        for number, member in enumerate(members):
            with about_member(number):
                if member[0] > 1e3:
                    raise SolverError("no solution")
        return members[:, :1]


SUMS = Sums(covariance=np.ones(2))
REFUSES = Refuses(covariance=np.ones(1))


def _model() -> Model:
    """Return a model with memory and model error; it is registered, so that workers can make it."""
    model: Model = registry().create("model", {**MODEL, **MODEL_ERROR})
    return model


def _batch(model: Model, n_members: int, cycle: int = 0, **changes: Any) -> Batch:
    """Return a batch of members in the middle of a run, when their memory is no longer the initial one."""
    members = model.first_guess(n_members, Streams(cycle).members("initial", 0)).ensemble.members
    memory = {"error": 0.1 + members[:, ::-1]}
    batch = Batch(members, memory, float(cycle), Streams(7).members("error", cycle))
    return replace(batch, **changes)


@contextmanager
def _started(factory: Factory) -> Iterator[tuple[Executor, Model]]:
    """Start an executor for the model, and close it."""
    executor, model = factory(), _model()
    with executor as running:
        running.start(model, registry().recipe(model))
        yield running, model


def _require_same(found: Stepped, expected: Stepped, message: str) -> None:
    require(len(found.steps) == len(expected.steps), f"{message}: {len(found.steps)} steps of {len(expected.steps)}")
    for one, other in zip(found.steps, expected.steps, strict=True):
        require_same_bits(one.members, other.members, f"{message}: other members")
        require_same_bits(one.memory, other.memory, f"{message}: another memory")
    require(set(found.predicted) == set(expected.predicted), f"{message}: readings after other steps")
    for number, predicted in expected.predicted.items():
        require_same_bits(found.predicted[number], predicted, f"{message}: other readings after {number} steps")


@check("executor")
def same_bits(factory: Factory) -> None:
    """For any number of members, the results, with memory and model error, are those of this process, bit for bit."""
    with _started(factory) as (executor, model):
        for n_members in (1, 2, 3, 7, 16):
            batch = _batch(model, n_members)
            message = f"{n_members} members differ when stepped by the executor"
            _require_same(executor.submit(model, batch)(), step_members(model, batch), message)


@check("executor")
def several_steps(factory: Factory) -> None:
    """A batch of several steps gives the members after the last step or after every step, and the readings of the operators in between."""  # noqa: E501
    with _started(factory) as (executor, model):
        for keep in (False, True):
            for operators in ({}, {1: SUMS, 3: SUMS}):
                batch = _batch(model, 5, n_steps=3, operators=operators, keep=keep)
                message = f"three steps, {'all' if keep else 'the last'} kept, {len(operators)} operators"
                _require_same(executor.submit(model, batch)(), step_members(model, batch), message)


@check("executor")
def several_at_once(factory: Factory) -> None:
    """Several batches may be under way at once; their results may be fetched in another order, or never."""
    with _started(factory) as (executor, model):
        batches = [_batch(model, 5, cycle, n_steps=1 + cycle % 2) for cycle in range(4)]
        under_way = [executor.submit(model, batch) for batch in batches]
        for number in (2, 0, 3):  # number 1 is never fetched
            message = f"batch {number} of four that were under way at once"
            _require_same(under_way[number](), step_members(model, batches[number]), message)


@check("executor")
def errors(factory: Factory) -> None:
    """An error of a model or an operator is raised again with its name and the number of the member, and does not affect the next batch."""  # noqa: E501
    with _started(factory) as (executor, model):
        for wrong in (0, 4):
            batch = _batch(model, 5, operators={1: REFUSES})
            members = np.array(batch.members)
            members[wrong] = 1e6
            try:
                executor.submit(model, replace(batch, members=members))()
            except SolverError as error:
                expected = f"member {wrong}: no solution"
                require(str(error) == expected, f"an error says '{error}', expected '{expected}'")
            except Exception as error:
                raise ConformanceError(f"expected a SolverError, got {type(error).__name__}: {error}") from error
            else:
                raise ConformanceError(f"an error of member {wrong} was lost")
            _require_same(executor.submit(model, batch)(), step_members(model, batch), "the batch after an error")


@check("executor")
def close(factory: Factory) -> None:
    """Closing ends everything, even batches whose results were not fetched; it may be called twice, and before the start."""  # noqa: E501
    import psutil

    this = psutil.Process()
    before = set(this.children(recursive=True))
    executor, model = factory(), _model()
    executor.close()
    try:
        executor.start(model, registry().recipe(model))
        executor.submit(model, _batch(model, 5))
    finally:
        executor.close()
        executor.close()
    started = [process for process in this.children(recursive=True) if process not in before]
    _, alive = psutil.wait_procs([process for process in started if not _is_pythons_own(process)], timeout=3.0)
    for process in alive:
        process.kill()
    require(not alive, f"{len(alive)} processes that the executor started were still there after its close")


def _is_pythons_own(process: Any) -> bool:
    """Return whether it is a helper process that Python keeps for the life of this process."""
    import psutil

    try:
        return "multiprocessing.resource_tracker" in " ".join(process.cmdline())
    except psutil.NoSuchProcess:  # it is gone already
        return False
