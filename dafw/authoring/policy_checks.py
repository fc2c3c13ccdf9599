"""Checks of policies."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dafw.authoring.checks import Factory, check, require
from dafw.authoring.evidence import (
    frozen,
    global_generators,
    no_global_draws,
    require_close,
    require_same_bits,
    restored,
)
from dafw.authoring.problems import airspace, belief, gas_space, vehicles
from dafw.authoring.small_study import Mover
from dafw.core.cycle import Parts, advance, start
from dafw.core.ensemble import Ensemble, Forecast, Memory, Vehicle
from dafw.core.executors.serial import Serial
from dafw.core.interfaces import Policy
from dafw.core.rerun import Rerun
from dafw.core.rng import Streams
from dafw.core.space import Array, StateSpace
from dafw.core.window import Outlook
from dafw.plugins.filters.none import NoFilter
from dafw.plugins.observers.none import NoObserver
from dafw.plugins.readings.twin import Twin

CYCLES = 4


def space_for(policy: Policy) -> StateSpace:
    """Return the space on which the policy is checked."""
    return policy.check_space() or gas_space()


def flown(
    factory: Factory, vehicle: Vehicle, *, fresh: bool = False, cycles: int = CYCLES, order: Sequence[int] = range(6)
) -> list[Array]:
    """Return the paths of all vehicles in several cycles as one list of arrays.

    ``fresh``: as if each cycle were run by a new process; ``order``: the order of the belief's members.
    """
    policy, paths = factory(), []
    memory: Memory | None = policy.initial_memory(vehicle)
    for cycle in range(cycles):
        if fresh:
            policy, memory = factory(), restored(memory)
        view = outlook(space_for(policy), vehicle, memory, cycle, order)
        route = policy.route(view.belief.ensemble, vehicle, memory, np.random.default_rng(cycle), view)
        paths += route.paths
        memory = route.memory
        vehicle = Vehicle(route.ends, vehicle.speed, vehicle.dt, vehicle.airspace)
    return paths


def outlook(
    space: StateSpace, vehicle: Vehicle, memory: Memory | None, cycle: int, order: Sequence[int] = range(6)
) -> Outlook:
    """Return an outlook over a belief of a model with memory."""
    seen = belief(space, seed=cycle)
    seen = Ensemble(seen.members[list(order)], space, float(cycle))
    model = Mover(space, seen.members, remembers=True)
    forecast = Forecast(seen, model.initial_memory(seen.members))
    return Outlook(forecast, vehicle, memory, cycle, Rerun(model, Serial(), Streams(0)))


@check("policy")
def shapes(factory: Factory) -> None:
    """With no, one or several vehicles, every vehicle gets a path that begins at its position and that it can fly in time."""  # noqa: E501
    for n_vehicles in (0, 1, 3):
        flown(factory, vehicles(n_vehicles))
        flown(factory, vehicles(n_vehicles, speed=0.0), cycles=1)


@check("policy")
def free_airspace(factory: Factory) -> None:
    """No vehicle is sent through a building or out of the domain."""
    for speed in (10.0, 60.0):
        for path in flown(factory, vehicles(3, speed=speed, domain=airspace())):
            for a, b in pairwise(path):
                require(airspace().is_free(a, b), f"the leg from {a.tolist()} to {b.tolist()} is blocked")


@check("policy")
def inputs_unchanged(factory: Factory) -> None:
    """A decision does not change the belief with its model's memory, the vehicle or the policy's memory: the cycle still needs them."""  # noqa: E501
    policy, vehicle = factory(), vehicles(2)
    memory = policy.initial_memory(vehicle)
    for cycle in range(2):
        view = outlook(space_for(policy), vehicle, memory, cycle)
        seen = view.belief
        parts = {"the belief": seen.ensemble.members, "the model's memory": seen.memory}
        parts |= {"the vehicle": vehicle.positions, "the memory": memory}
        before = {name: frozen(part) for name, part in parts.items()}
        route = policy.route(seen.ensemble, vehicle, memory, np.random.default_rng(0), view)
        changed = [name for name, part in parts.items() if frozen(part) != before[name]]
        require(not changed, f"a decision changed {', '.join(changed)}")
        memory = route.memory


@check("policy")
def determinism(factory: Factory) -> None:
    """The same belief, vehicle and generator give the same route, bit for bit: a study can be repeated."""
    with global_generators():
        first = flown(factory, vehicles(2))
    with global_generators():
        second = flown(factory, vehicles(2))
    _require_same_ways(first, second, "two decisions about the same differ")


@check("policy")
def own_generator(factory: Factory) -> None:
    """Random numbers come from the generator passed in, never from global ones, which any other code may advance."""
    with no_global_draws():
        flown(factory, vehicles(1))


@check("policy")
def member_order(factory: Factory) -> None:
    """Members are exchangeable: a belief with its members in another order leads to the same route."""
    first = flown(factory, vehicles(1), cycles=1)
    second = flown(factory, vehicles(1), cycles=1, order=(3, 0, 5, 1, 4, 2))
    for a, b in zip(first, second, strict=True):
        require_close(b, a, 1e-9, "the way depends on the order of the members")


@check("policy")
def restart(factory: Factory) -> None:
    """A run stopped after any cycle and continued from its file has the same routes: the plugin keeps nothing on itself."""  # noqa: E501
    with global_generators():
        whole = flown(factory, vehicles(2))
    with global_generators():
        pieces = flown(factory, vehicles(2), fresh=True)
    _require_same_ways(whole, pieces, "the way differs in a run that was cut off before it")


def _require_same_ways(first: list[Array], second: list[Array], message: str) -> None:
    for a, b in zip(first, second, strict=True):
        require_same_bits(a, b, message)


@check("policy")
def truth_blind(factory: Factory) -> None:
    """A policy does not see the truth: if the truth is replaced by another one, every decision stays the same."""
    space = space_for(factory())
    members = belief(space).members

    def mover(factor: float) -> Mover:
        return Mover(space, space.retract(factor * members, np.zeros(space.size)), remembers=True)

    for other in (0.25, 4.0):
        _require_same_ways(
            _decisions(factory(), mover(1.0), mover(1.0)),
            _decisions(factory(), mover(1.0), mover(other)),
            "with another truth, and the same belief, the vehicle flies elsewhere",
        )


def _decisions(policy: Policy, model: Mover, truth: Mover) -> list[Array]:
    """Return the paths flown in a study whose belief does not depend on the truth."""
    parts = Parts(model, truth, None, NoObserver(), policy, NoFilter(), Twin(), Streams(0))
    state = start(parts, len(model.members), vehicles(2))
    paths: list[Array] = []
    for _ in range(CYCLES):
        cycle = advance(parts, state)
        state = cycle.state
        paths += cycle.route.paths
    return paths
