"""The one time loop, as a pure function from state to state.

::

    belief(t) --Policy--> route --Observer--> H_t, R_t
    belief(t) --Model---> forecast(t+dt)
    truth(t)  --Model---> truth(t+dt) --H_t, noise--> y
    forecast, H_t(forecast), y, R_t --Filter--> belief(t+dt)

``State`` is all that a cycle needs from the one before; random numbers are addressed by seed, role and cycle. So a
run can be cut anywhere and continued to the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from time import perf_counter
from typing import Self

from dafw.core.ensemble import Diagnostics, Ensemble, Forecast, Memory, Route, Vehicle
from dafw.core.errors import ComputationError, DafwError
from dafw.core.executors import Executor
from dafw.core.executors.serial import Serial
from dafw.core.interfaces import Filter, Model, Observer, Policy
from dafw.core.observation import Observation, colour
from dafw.core.plugin import Plugin
from dafw.core.rng import Streams
from dafw.core.space import Array

PHASES = ("decide", "forecast", "truth", "free", "observe", "analyse", "record")


@dataclass(frozen=True)
class Parts:
    """What a study is composed of; ``truth`` and ``free`` are models of one state space, ``free`` may be absent.

    ``executor`` steps the members of the belief; the truth and the free run are stepped here.
    """

    model: Model
    truth: Model
    free: Model | None
    observer: Observer
    policy: Policy
    filter: Filter
    streams: Streams
    executor: Executor = field(default_factory=Serial)


@dataclass(frozen=True)
class State:
    """Everything that the next cycle depends on."""

    cycle: int
    belief: Forecast
    truth: Forecast
    free: Forecast | None
    vehicle: Vehicle
    policy_memory: Memory | None
    filter_memory: Memory | None


@dataclass(frozen=True)
class Cycle:
    """One finished cycle: the state after it, and how it came about."""

    state: State
    forecast: Ensemble
    route: Route
    observation: Observation
    predicted: Array
    diagnostics: dict[str, Diagnostics]
    seconds: dict[str, float]


@dataclass
class _Clock:
    """Times the phases of a cycle and says in which one something went wrong."""

    time: float
    seconds: dict[str, float] = field(default_factory=dict)

    def phase(self, name: str, plugin: Plugin) -> Self:
        """Begin a phase: ``with clock.phase(...):``, one after the other."""
        self._name, self._plugin, self._begun = name, plugin, perf_counter()
        return self

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None:
            self.seconds[self._name] = self.seconds.get(self._name, 0.0) + perf_counter() - self._begun
            return
        place = f"at t = {self.time:g} s, phase '{self._name}'"
        if isinstance(error, DafwError):
            raise type(error)(f"{place}: {error}") from error
        if isinstance(error, Exception):
            raise ComputationError(f"{place}: {self._plugin.label} raised {type(error).__name__}: {error}") from error


def start(parts: Parts, n_members: int, vehicle: Vehicle) -> State:
    """Draw the truth, the first belief and the start of the free run."""
    parts.filter.require_members(n_members)
    clock, streams = _Clock(0.0), parts.streams
    with clock.phase("initial", parts.truth):
        truth = parts.truth.first_guess(1, streams.members("initial truth", 0))
    with clock.phase("initial", parts.model):
        belief = parts.model.first_guess(n_members, streams.members("initial belief", 0))
        free = parts.free.first_guess(1, streams.members("initial free", 0)) if parts.free else None
    with clock.phase("initial", parts.policy):
        policy_memory = parts.policy.initial_memory(vehicle)
    with clock.phase("initial", parts.filter):
        filter_memory = parts.filter.initial_memory(n_members)
    return State(
        cycle=0,
        belief=belief,
        truth=truth,
        free=free,
        vehicle=vehicle,
        policy_memory=policy_memory,
        filter_memory=filter_memory,
    )


def advance(parts: Parts, state: State) -> Cycle:
    """Run one cycle. Raises a DafwError that says at which time and in which phase it failed."""
    streams, cycle = parts.streams, state.cycle
    belief, truth, free = state.belief, state.truth, state.free
    clock = _Clock(belief.ensemble.time)
    roles = ("policy", "observation noise", "filter")
    policy_rng, noise_rng, filter_rng = (streams.generator(role, cycle) for role in roles)

    with clock.phase("decide", parts.policy):
        route = parts.policy.route(belief.ensemble, state.vehicle, state.policy_memory, policy_rng)
    with clock.phase("observe", parts.observer):
        operator = parts.observer.look(parts.model.space, route, belief.ensemble.time)
        noise = colour(operator.noise, noise_rng.standard_normal(operator.size))
    with clock.phase("forecast", parts.model):
        now, errors = belief.ensemble.time, streams.members("model error", cycle)
        belief_step = parts.executor.submit(parts.model, belief.ensemble.members, belief.memory, now, errors)
    # While workers are at it, this process has the truth and the free run. All steps come before the checks: a step
    # sweeps the processor's caches, and what stands between two of them runs from memory.
    with clock.phase("truth", parts.truth):
        now, errors = truth.ensemble.time, streams.members("truth error", cycle)
        truth_step = parts.truth.step_with_memory(truth.ensemble.members, truth.memory, now, errors)
    if parts.free and free:
        with clock.phase("free", parts.free):
            free = parts.free.forecast(free.ensemble, free.memory, streams.members("free error", cycle))
    with clock.phase("truth", parts.truth):
        truth = parts.truth.stepped(truth.ensemble, truth_step)
    with clock.phase("forecast", parts.model):
        forecast = parts.model.stepped(belief.ensemble, belief_step())
    with clock.phase("observe", parts.observer):
        readings = parts.observer.read(operator, truth.ensemble)[0] + noise
        observation = Observation(readings, operator, forecast.ensemble.time)
        predicted = parts.observer.read(operator, forecast.ensemble)
    with clock.phase("analyse", parts.filter):
        analysis = parts.filter.update(forecast.ensemble, predicted, observation, state.filter_memory, filter_rng)

    posterior = Ensemble(analysis.members, forecast.ensemble.space, forecast.ensemble.time)
    after = State(
        cycle=cycle + 1,
        belief=Forecast(posterior, forecast.memory),
        truth=Forecast(truth.ensemble, truth.memory),
        free=free,
        vehicle=state.vehicle.moved(route.ends),
        policy_memory=route.memory,
        filter_memory=analysis.memory,
    )
    diagnostics = {"policy": route.diagnostics, "model": forecast.diagnostics, "filter": analysis.diagnostics}
    return Cycle(after, forecast.ensemble, route, observation, predicted, diagnostics, clock.seconds)
