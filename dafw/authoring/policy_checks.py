"""Checks of policies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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
from dafw.authoring.problems import Linear, airspace, belief, gas_space, vehicles
from dafw.core.cycle import Parts, advance, start
from dafw.core.ensemble import Analysis, Ensemble, Memory, Route, Vehicle
from dafw.core.interfaces import Filter, Model, Observer, Policy
from dafw.core.observation import Observation, ObservationOperator
from dafw.core.rng import MemberStreams, Streams
from dafw.core.space import Array, StateSpace
from dafw.plugins.readings.twin import Twin

CYCLES = 4


def space_for(policy: Policy) -> StateSpace:
    """Return the space on which the policy is checked."""
    return policy.check_space() or gas_space()


def flown(
    factory: Factory, vehicle: Vehicle, *, fresh: bool = False, cycles: int = CYCLES, order: Sequence[int] = range(6)
) -> list[Array]:
    """Return what the vehicles fly in some cycles, as (path,) arrays one after the other.

    ``fresh``: as if each cycle were run by a new process; ``order``: of the belief's members.
    """
    policy, paths = factory(), []
    memory: Memory | None = policy.initial_memory(vehicle)
    for cycle in range(cycles):
        if fresh:
            policy, memory = factory(), restored(memory)
        seen = belief(space_for(policy), seed=cycle)
        seen = Ensemble(seen.members[list(order)], seen.space, float(cycle))
        route = policy.route(seen, vehicle, memory, np.random.default_rng(cycle))
        paths += route.paths
        memory = route.memory
        vehicle = Vehicle(route.ends, vehicle.speed, vehicle.dt, vehicle.airspace)
    return paths


@check("policy")
def shapes(factory: Factory) -> None:
    """Every vehicle, be there none, one or several, gets a way that begins where it is and that it can fly in time."""
    for n_vehicles in (0, 1, 3):
        flown(factory, vehicles(n_vehicles))
        flown(factory, vehicles(n_vehicles, speed=0.0), cycles=1)


@check("policy")
def free_airspace(factory: Factory) -> None:
    """Nobody is sent through a building or out of the domain."""
    for speed in (10.0, 60.0):
        for path in flown(factory, vehicles(3, speed=speed, domain=airspace())):
            for a, b in pairwise(path):
                require(airspace().is_free(a, b), f"the leg from {a.tolist()} to {b.tolist()} is blocked")


@check("policy")
def inputs_unchanged(factory: Factory) -> None:
    """A decision leaves belief, vehicle and memory as they were handed in: the cycle still needs them."""
    policy, vehicle = factory(), vehicles(2)
    seen, memory = belief(space_for(policy)), policy.initial_memory(vehicle)
    for _ in range(2):
        before = [frozen(part) for part in (seen.members, vehicle.positions, memory)]
        route = policy.route(seen, vehicle, memory, np.random.default_rng(0))
        after = [frozen(part) for part in (seen.members, vehicle.positions, memory)]
        for name, a, b in zip(("the belief", "the vehicle", "the memory"), before, after, strict=True):
            require(a == b, f"a decision changed {name}")
        memory = route.memory


@check("policy")
def determinism(factory: Factory) -> None:
    """The same belief, vehicle and generator give the same way, bit for bit: a study can be repeated."""
    with global_generators():
        first = flown(factory, vehicles(2))
    with global_generators():
        second = flown(factory, vehicles(2))
    _require_same_ways(first, second, "two decisions about the same differ")


@check("policy")
def own_generator(factory: Factory) -> None:
    """Random numbers come from the generator handed in: global ones are shared, and change when anything else does."""
    with no_global_draws():
        flown(factory, vehicles(1))


@check("policy")
def member_order(factory: Factory) -> None:
    """Members are exchangeable: a belief with its members in another order leads to the same way."""
    first = flown(factory, vehicles(1), cycles=1)
    second = flown(factory, vehicles(1), cycles=1, order=(3, 0, 5, 1, 4, 2))
    for a, b in zip(first, second, strict=True):
        require_close(b, a, 1e-9, "the way depends on the order of the members")


@check("policy")
def restart(factory: Factory) -> None:
    """A run cut off after any cycle and continued from its file flies the same: nothing is remembered on the plugin."""
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
    """No cheating: with the truth exchanged behind its back, every decision is the same."""
    space = space_for(factory())
    model = _Still(space)
    for other in (0.25, 4.0):
        _require_same_ways(
            _decisions(factory(), model, _Still(space, 1.0)),
            _decisions(factory(), model, _Still(space, other)),
            "with another truth, and the same belief, the vehicle flies elsewhere",
        )


def _decisions(policy: Policy, model: Model, truth: Model) -> list[Array]:
    """Return the ways flown in a study whose belief never hears of the truth."""
    parts = Parts(model, truth, None, _Nothing(), policy, _Unmoved(), Twin(), Streams(0))
    state = start(parts, 6, vehicles(2))
    paths: list[Array] = []
    for _ in range(CYCLES):
        cycle = advance(parts, state)
        state = cycle.state
        paths += cycle.route.paths
    return paths


@dataclass
class _Still(Model):
    """Nothing happens; the members are a belief times a factor."""

    space: StateSpace
    factor: float = 1.0
    dt: float = 1.0

    def initial(self, n_members: int, rng: MemberStreams) -> Array:
        return self.factor * belief(self.space, n_members).members

    def step(self, members: Array, t: float, rng: MemberStreams) -> Array:
        return members


class _Nothing(Observer):
    """Reads nothing."""

    def operator(self, space: StateSpace, route: Route, t: float) -> ObservationOperator:
        return Linear(matrix=np.empty((0, space.size)), covariance=np.empty(0))


class _Unmoved(Filter):
    """Believes what it believed."""

    def analyse(
        self, forecast: Ensemble, predicted: Array, observation: Observation, rng: np.random.Generator
    ) -> Analysis:
        return Analysis(forecast.members)
