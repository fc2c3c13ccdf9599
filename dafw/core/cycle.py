"""The one time loop, as a pure function from state to state.

::

    belief(t) --Policy--> route --Observer--> H_t, R_t
    belief(t) --Model---> forecast(t+dt)
    truth(t)  --Model---> truth(t+dt)                          where there is a truth
    H_t, truth(t+dt) or what came in --Readings--> y, with its time
    past, forecast, H(forecast), y, R, re-run --Filter--> belief(t+dt), revised past

``State`` is all that a cycle needs from the one before; random numbers are addressed by seed, role and cycle. So a
run can be cut anywhere and continued to the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from time import perf_counter
from typing import Self

from dafw.core.ensemble import Analysis, Diagnostics, Ensemble, Forecast, Memory, Route, Vehicle, handed_over
from dafw.core.errors import ComputationError, DafwError
from dafw.core.executors import Executor
from dafw.core.executors.batches import Batch
from dafw.core.executors.serial import Serial
from dafw.core.interfaces import Filter, Model, Observer, Policy, Readings
from dafw.core.interfaces.readings import Request, Taken
from dafw.core.interpolation import View
from dafw.core.late import Sorted, sort_by_cycle
from dafw.core.observation import Observation
from dafw.core.past import kept, with_late
from dafw.core.plugin import Plugin, label_of
from dafw.core.rerun import MODEL_ERROR, Rerun
from dafw.core.rng import Streams
from dafw.core.space import Array
from dafw.core.window import Outlook, PastCycle, Window

TRUTH_ERROR, FREE_ERROR = "truth error", "free error"
"""The roles of the random streams of the truth's and the free run's steps."""
PHASES = ("decide", "forecast", "truth", "free", "observe", "analyse", "record")


@dataclass(frozen=True)
class Parts:
    """What a study is composed of. ``truth`` and ``free`` are models that may be absent.

    ``truth_view`` maps the truth to the belief's state space; None if both spaces are the same.
    ``late_readings`` says what to do with a late reading that is older than the filter's window: ``use`` it as if it
    were taken now, or ``drop`` it. ``executor`` steps the members of the belief; truth and free run are stepped in
    this process.
    """

    model: Model
    truth: Model | None
    free: Model | None
    observer: Observer
    policy: Policy
    filter: Filter
    readings: Readings
    streams: Streams
    executor: Executor = field(default_factory=Serial)
    late_readings: str = "drop"
    truth_view: View | None = None

    @cached_property
    def rerun(self) -> Rerun:
        """What runs the model again."""
        return Rerun(self.model, self.executor, self.streams)

    def seen(self, truth: Forecast | None) -> Ensemble | None:
        """Return the truth in the belief's state space."""
        if truth is None or self.truth_view is None:
            return truth.ensemble if truth else None
        return self.truth_view.of(truth.ensemble)


@dataclass(frozen=True)
class State:
    """Everything that the next cycle depends on. ``past`` are the cycles that the filter may look back to."""

    cycle: int
    belief: Forecast
    truth: Forecast | None
    free: Forecast | None
    vehicle: Vehicle
    policy_memory: Memory | None = None
    filter_memory: Memory | None = None
    readings_memory: Memory | None = None
    past: tuple[PastCycle, ...] = ()


@dataclass(frozen=True)
class Cycle:
    """One finished cycle: the state after it, and the intermediate results.

    ``truth`` is the truth after the cycle, in the belief's state space. ``readings`` are sorted by the cycle that they
    belong to. ``predicted`` (N, m) is what the forecast predicts for the readings used at the end of this cycle.
    ``left_out`` counts readings that their source could not give, by reason.
    """

    state: State
    forecast: Ensemble
    truth: Ensemble | None
    route: Route
    readings: Sorted
    predicted: Array
    analysis: Analysis
    diagnostics: dict[str, Diagnostics]
    notes: tuple[str, ...]
    seconds: dict[str, float]
    left_out: Mapping[str, int] = field(default_factory=dict)

    @property
    def belief(self) -> Ensemble:
        """The belief after the cycle."""
        return self.state.belief.ensemble

    @property
    def observation(self) -> Observation:
        """The readings that were used at the end of this cycle."""
        return self.readings.now


class _Clock:
    """Times the phases of a cycle, which follow one another, and adds the phase to an error raised in it."""

    def __init__(self, time: float, name: str, plugin: Plugin) -> None:
        self.time = time
        self.seconds: dict[str, float] = {}
        self._name, self._plugin, self._begun = name, plugin, perf_counter()

    def phase(self, name: str, plugin: Plugin) -> None:
        """End the present phase and begin the next, in which ``plugin`` works."""
        now = perf_counter()
        self.seconds[self._name] = self.seconds.get(self._name, 0.0) + now - self._begun
        self._name, self._plugin, self._begun = name, plugin, now

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None:
            self.phase(self._name, self._plugin)  # ends the last one
            return
        place = f"at t = {self.time:g} s, phase '{self._name}'"
        if not isinstance(error, Exception):
            return
        if isinstance(error, DafwError):
            failure = type(error)(f"{place}: {error}")
        else:
            failure = ComputationError(f"{place}: {label_of(self._plugin)} raised {type(error).__name__}: {error}")
        failure.time, failure.phase = self.time, self._name
        raise failure from error


def start(parts: Parts, n_members: int, vehicle: Vehicle) -> State:
    """Draw the truth, the first belief and the start of the free run."""
    parts.filter.require_members(n_members)
    streams = parts.streams
    truth = free = None
    with _Clock(0.0, "initial", parts.model) as clock:
        if parts.truth is not None:
            clock.phase("initial", parts.truth)
            truth = parts.truth.first_guess(1, streams.members("initial truth", 0))
        clock.phase("initial", parts.model)
        belief = parts.model.first_guess(n_members, streams.members("initial belief", 0))
        if parts.free is not None:
            free = parts.free.first_guess(1, streams.members("initial free", 0))
        clock.phase("initial", parts.policy)
        policy_memory = parts.policy.initial_memory(vehicle)
        clock.phase("initial", parts.filter)
        filter_memory = parts.filter.initial_memory(n_members)
        clock.phase("initial", parts.readings)
        readings_memory = parts.readings.initial_memory()
    return State(0, belief, truth, free, vehicle, policy_memory, filter_memory, readings_memory)


def advance(parts: Parts, state: State, decided: Callable[[Route], None] | None = None) -> Cycle:
    """Run one cycle. Raises a DafwError that says at which time and in which phase it failed.

    ``decided`` is called with the route as soon as the policy has decided, before readings are waited for.
    """
    streams, cycle = parts.streams, state.cycle
    belief, truth, free = state.belief, state.truth, state.free
    now = belief.ensemble.time
    # All at once: each takes 50 microseconds if it is made alone, after a model's step, and 12 beside another.
    roles = ("policy", "observation noise", "filter")
    deciding, reading, analysing = (streams.generator(role, cycle) for role in roles)

    with _Clock(now, "decide", parts.policy) as clock:
        outlook = None
        if parts.policy.looks_ahead:
            outlook = Outlook(belief, state.vehicle, state.policy_memory, cycle, parts.rerun)
        route = parts.policy.route(belief.ensemble, state.vehicle, state.policy_memory, deciding, outlook)
        if decided is not None:
            decided(route)

        clock.phase("observe", parts.observer)
        operator = parts.observer.look(parts.model.space, route, now)

        clock.phase("forecast", parts.model)
        errors = streams.members(MODEL_ERROR, cycle)
        stepped = parts.executor.submit(parts.model, Batch(belief.ensemble.members, belief.memory, now, errors))
        # While the workers step the belief, this process steps the truth and the free run. The truth is checked after
        # the free run's step, beside the belief: what stands between two steps runs from slow memory.
        truth_step = None
        if parts.truth is not None and truth is not None:
            clock.phase("truth", parts.truth)
            errors, at = streams.members(TRUTH_ERROR, cycle), truth.ensemble
            truth_step = parts.truth.step_with_memory(at.members, truth.memory, at.time, errors)
        if parts.free is not None and free is not None:
            clock.phase("free", parts.free)
            free = parts.free.forecast(free.ensemble, free.memory, streams.members(FREE_ERROR, cycle))
        if parts.truth is not None and truth is not None and truth_step is not None:
            clock.phase("truth", parts.truth)
            truth = parts.truth.stepped(truth.ensemble, truth_step)
        clock.phase("forecast", parts.model)
        forecast = parts.model.stepped(belief.ensemble, stepped().steps[-1])

        clock.phase("observe", parts.readings)
        truth_seen = parts.seen(truth)
        end = forecast.ensemble.time
        told = truth_seen if parts.readings.needs_truth else None
        request = Request(cycle, now, end, parts.model.space, parts.model.domain, operator, told)
        taken = parts.readings.collect(request, state.readings_memory, reading)
        reach = [*(past.number for past in state.past), cycle] if parts.filter.window != 0 else [cycle]
        readings = sort_by_cycle(taken.observations, request, parts.model.dt, reach, parts.late_readings)
        clock.phase("observe", parts.observer)
        predicted = parts.observer.read(readings.now.operator, forecast.ensemble)

        clock.phase("analyse", parts.filter)
        past: tuple[PastCycle, ...] = ()
        if parts.filter.window == 0:
            analysis = parts.filter.update(forecast.ensemble, predicted, readings.now, state.filter_memory, analysing)
        else:
            past = with_late((*state.past, PastCycle(cycle, belief, readings.now)), readings.late)
            window = Window(past, forecast, predicted, readings.late, state.filter_memory, parts.rerun)
            analysis = parts.filter.look_back(window, analysing)
            past = kept(parts.filter, past, analysis)

    posterior = forecast.ensemble.with_members(handed_over(analysis.members), analysis.weights)
    model_memory = forecast.memory if analysis.model_memory is None else analysis.model_memory
    after = State(
        cycle=cycle + 1,
        belief=Forecast(posterior, model_memory),
        truth=truth,
        free=free,
        vehicle=_arrived(state.vehicle, route, taken),
        policy_memory=route.memory,
        filter_memory=analysis.memory,
        readings_memory=taken.memory,
        past=past,
    )
    diagnostics = {
        "policy": route.diagnostics,
        "model": forecast.diagnostics,
        "observer": operator.diagnostics,
        "filter": analysis.diagnostics,
    }
    notes = (*route.notes, *taken.notes)
    return Cycle(
        after,
        forecast.ensemble,
        truth_seen,
        route,
        readings,
        predicted,
        analysis,
        diagnostics,
        notes,
        clock.seconds,
        taken.left_out,
    )


def _arrived(vehicle: Vehicle, route: Route, taken: Taken) -> Vehicle:
    """Return the vehicles at the end of a cycle: where the readings say they are, otherwise where they were sent."""
    if taken.vehicles is None:
        return vehicle.moved(route.ends) if route.paths else vehicle
    positions = vehicle.positions.copy()
    for number, place in taken.vehicles.items():
        if number < len(positions):
            positions[number] = place
    return vehicle.moved(positions)
