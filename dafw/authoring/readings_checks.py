"""Checks of sources of readings."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace

import numpy as np

from dafw.authoring.checks import Factory, NotApplicable, check, require
from dafw.authoring.evidence import (
    frozen,
    global_generators,
    no_global_draws,
    require_same_bits,
    restored,
)
from dafw.authoring.problems import airspace, belief, gas_space
from dafw.core.domain import Domain
from dafw.core.ensemble import Ensemble, Memory
from dafw.core.interfaces import Readings
from dafw.core.interfaces.readings import Request, Taken
from dafw.core.observation import Observation, ObservationOperator, Selection, nothing
from dafw.core.space import ANGLE, StateSpace

CYCLES = 5
DT = 1.0


def space_for(source: Readings) -> StateSpace:
    """Return the space on which the source is checked."""
    return source.check_space() or gas_space()


def _operator(space: StateSpace, cycle: int) -> ObservationOperator:
    """Return what the observer would read: two entries with correlated errors, but nothing in the third cycle.

    They are the first and the last that are no angles, which a run refuses as readings.
    """
    if cycle == 2:
        return nothing()
    plain = [space.slice(variable.name) for variable in space.variables if variable.kind is not ANGLE]
    return Selection(
        indices=np.array([plain[0].start, plain[-1].stop - 1]), covariance=np.array([[0.04, 0.01], [0.01, 0.09]])
    )


def domain_for(source: Readings) -> Domain | None:
    """Return the domain of the space on which the source is checked: the kit's own, or None."""
    return airspace() if source.check_space() is None else None


def suited(factory: Factory) -> Readings:
    """Return a source after its ``suit`` with the study's space; raises ConfigurationError if they do not fit."""
    source: Readings = factory()
    source.suit(space_for(source), domain_for(source), DT)
    return source


def requests(source: Readings, *, truth: bool | None = None) -> Iterator[Request]:
    """Yield the requests of several cycles in order.

    ``truth``: whether the study has a truth; None: only if the source needs it.
    """
    space, domain = space_for(source), domain_for(source)
    for cycle in range(CYCLES):
        end = (cycle + 1) * DT
        state = Ensemble(belief(space, 1, seed=cycle).members, space, end)
        has_truth = source.needs_truth if truth is None else truth
        yield Request(cycle, cycle * DT, end, space, domain, _operator(space, cycle), state if has_truth else None)


def taken(
    factory: Factory, *, fresh: bool = False, seed: int = 0, truth: bool | None = None
) -> list[tuple[Request, Taken]]:
    """Return a source's readings in several cycles; ``fresh``: as if each cycle were run by a new process."""
    source = suited(factory)
    memory: Memory | None = source.initial_memory()
    found = []
    for request in requests(source, truth=truth):
        if fresh:
            source, memory = suited(factory), restored(memory)
        got = source.collect(request, memory, np.random.default_rng([seed, request.cycle]))
        memory = got.memory
        found.append((request, replace(got, memory=deepcopy(got.memory))))
    return found


def _require_same(first: list[tuple[Request, Taken]], second: list[tuple[Request, Taken]], message: str) -> None:
    for (request, one), (_, other) in zip(first, second, strict=True):
        where = f"cycle {request.cycle}: {message}"
        require(len(one.observations) == len(other.observations), f"{where}, in their number")
        for mine, theirs in zip(one.observations, other.observations, strict=True):
            require_same_bits(mine.values, theirs.values, where)
            require_same_bits(mine.covariance, theirs.covariance, f"{where}, in R")
            require(mine.time == theirs.time, f"{where}, in their time")
        require_same_bits(one.memory, other.memory, f"{where}, in the memory")


@check("readings")
def shapes(factory: Factory) -> None:
    """Readings are finite numbers, none is from the future, and their operators can be applied to the belief."""
    for seed in range(8):
        for request, got in taken(factory, seed=seed):
            for observation in got.observations:
                _require_readable(observation, request)


def _require_readable(observation: Observation, request: Request) -> None:
    """Raise ConformanceError if the observation's operator cannot be applied to the members of a belief."""
    for n_members in (1, 5):
        predicted = observation.operator.apply(belief(request.space, n_members).members)
        expected = (n_members, observation.values.size)
        where = f"cycle {request.cycle}: of {n_members} members the operator makes"
        require(predicted.shape == expected, f"{where} an array {predicted.shape}, expected {expected}")
        require(np.isfinite(predicted).all(), f"{where} numbers that are not finite")


@check("readings")
def inputs_unchanged(factory: Factory) -> None:
    """A source does not change the truth, operator or memory that it is given: they are still needed."""
    source = suited(factory)
    memory: Memory | None = source.initial_memory()
    for request in requests(source):
        parts = {"the operator's R": request.operator.covariance, "the memory": memory}
        if request.truth is not None:
            parts["the truth"] = request.truth.members
        before = {name: frozen(part) for name, part in parts.items()}
        got = source.collect(request, memory, np.random.default_rng([0, request.cycle]))
        changed = [name for name, part in parts.items() if frozen(part) != before[name]]
        require(not changed, f"cycle {request.cycle}: the source changed {', '.join(changed)}")
        memory = got.memory


@check("readings")
def determinism(factory: Factory) -> None:
    """The same request and the same generator give the same readings, bit for bit: a study can be repeated."""
    with global_generators():
        first = taken(factory)
    with global_generators():
        second = taken(factory)
    _require_same(first, second, "two readings of the same differ")


@check("readings")
def own_generator(factory: Factory) -> None:
    """Random numbers come from the generator passed in, never from global ones, which any other code may advance."""
    with no_global_draws():
        taken(factory)


@check("readings")
def restart(factory: Factory) -> None:
    """A run stopped after any cycle and continued from its file has the same readings: the source keeps nothing on itself."""  # noqa: E501
    with global_generators():
        whole = taken(factory)
    with global_generators():
        pieces = taken(factory, fresh=True)
    _require_same(whole, pieces, "the readings differ in a run that was cut off before it")


@check("readings")
def without_truth(factory: Factory) -> None:
    """A source without ``needs_truth = True`` works without a truth, and ignores the truth if there is one."""
    if factory().needs_truth:
        raise NotApplicable("declares that it needs a truth")
    with global_generators():
        without = taken(factory, truth=False)
    with global_generators():
        beside = taken(factory, truth=True)
    _require_same(without, beside, "the readings change where the study has a truth, which was not declared")
