"""Small studies for the checks: a few cycles of the real loop, so that plugins are called as in real studies.

One analysis would not be enough: a filter has memory, weights and a window only from the second analysis on.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from dafw.authoring.checks import Factory, require
from dafw.authoring.evidence import frozen, require_same_bits, restored
from dafw.authoring.problems import Problem
from dafw.core.cycle import Cycle, Parts, State, advance, start
from dafw.core.ensemble import Analysis, Ensemble, Forecast, Memory, Step, Vehicle
from dafw.core.executors import Executor
from dafw.core.executors.serial import Serial
from dafw.core.interfaces import Filter, Model, Readings
from dafw.core.interfaces.readings import Request
from dafw.core.observation import Observation
from dafw.core.rng import MemberStreams, Streams
from dafw.core.space import Array, StateSpace
from dafw.core.window import PastCycle
from dafw.plugins.observers.none import NoObserver
from dafw.plugins.policies.stationary import Stationary

CYCLES = 3
"""The default number of analyses; all but the first are given the memory and weights of the one before."""


@dataclass
class Mover(Model):
    """Starts from given members (N, n) and multiplies them by ``matrix`` (n, n) in each step; None: they stay.

    If ``remembers``, every member also moves by a decaying drift, which is held in the model's memory.
    """

    space: StateSpace
    members: Array
    matrix: Array | None = None
    error_sd: float = 0.0
    remembers: bool = False
    dt: float = 1.0

    def initial(self, n_members: int, rng: MemberStreams) -> Array:
        """Return the first of the given members."""
        return np.array(self.members[:n_members])

    def log_first_guess(self, members: Array) -> Array:
        """Return the log density (N,) of the Gaussian with the mean and covariance of the given members."""
        mean = self.space.mean(self.members)
        anomalies = self.space.difference(self.members, mean)
        covariance = anomalies.T @ anomalies / (len(anomalies) - 1) + 1e-6 * np.eye(self.space.size)
        offset = self.space.difference(members, mean)
        misfit = np.einsum("ij,ij->i", offset, np.linalg.solve(covariance, offset.T).T)
        return np.asarray(-0.5 * (misfit + np.linalg.slogdet(2.0 * np.pi * covariance)[1]))

    def coarser(self) -> Model:
        """Return the model itself: none is cheaper."""
        return self

    def initial_memory(self, members: Array) -> Memory | None:
        """Return the drift (N,) of each member, which depends on its state."""
        return {"drift": 0.1 * members[:, 0]} if self.remembers else None

    def step_with_memory(self, members: Array, memory: Memory | None, t: float, rng: MemberStreams) -> Step:
        """Return the members a second later."""
        # A matrix product rounds otherwise for one member than for several: bits would depend on who steps them.
        moved = members if self.matrix is None else (members[:, np.newaxis] * self.matrix).sum(axis=2)
        if self.error_sd > 0.0:
            moved = moved + self.error_sd * rng.standard_normal(moved.shape)
        if memory is None:
            return Step(self.space.retract(moved, np.zeros(self.space.size)))
        drift = np.asarray(memory["drift"])
        return Step(
            self.space.retract(moved, np.repeat(drift[:, np.newaxis], self.space.size, axis=1)), {"drift": 0.9 * drift}
        )


@dataclass
class Given(Readings):
    """Returns given observations, keyed by the cycle in which they arrive."""

    arrivals: tuple[tuple[Observation, ...], ...]

    def take(self, request: Request, rng: np.random.Generator) -> Sequence[Observation]:
        """Return the observations that arrive in this cycle."""
        return self.arrivals[request.cycle]


@dataclass(frozen=True, eq=False)
class SmallStudy:
    """A model, and its readings keyed by the cycle in which they arrive."""

    model: Mover
    arrivals: tuple[tuple[Observation, ...], ...]

    def remembering(self, *, error_sd: float = 0.0) -> SmallStudy:
        """Return the study with a model that has a memory, and a model error if ``error_sd`` > 0."""
        return replace(self, model=replace(self.model, remembers=True, error_sd=error_sd))

    def run(
        self, factory: Factory, *, seed: int = 0, executor: Executor | None = None, cut: bool = False
    ) -> list[Cycle]:
        """Return all cycles with a filter of the factory.

        ``cut``: as if each cycle were run by a new process that reads what the last one wrote. Raises the errors of a
        study, such as ConfigurationError if the filter declines the problem.
        """
        filter_ = factory()
        filter_.suit(self.model.space, len(self.model.members))
        parts = Parts(
            self.model,
            None,
            None,
            NoObserver(),
            Stationary(),
            filter_,
            Given(self.arrivals),
            Streams(seed),
            executor or Serial(),
        )
        state = start(parts, len(self.model.members), Vehicle(np.empty((0, 2))))
        cycles: list[Cycle] = []
        for _ in self.arrivals:
            if cut:
                parts, state = replace(parts, filter=factory()), reread(state)
            cycles.append(advance(parts, state))
            state = cycles[-1].state
        return cycles


def growth(n: int) -> Array:
    """Return a matrix (n, n) that mixes neighbours and makes all grow a little, to restore spread in each cycle."""
    return 1.1 * np.eye(n) + 0.2 * np.eye(n, k=1)


def study_of(problem: Problem, *later: Problem, still: bool = False) -> SmallStudy:
    """Return the study in which the readings of each problem are taken at the end of its cycle.

    With a single problem it has ``CYCLES`` cycles, in which the readings change a little. The members at the start are
    those of the first problem's forecast; ``still``: they do not move, so the first forecast is that of the problem.
    """
    problems = [problem, *later]
    if not later:
        problems = [replace(problem, values=problem.values + 0.1 * cycle) for cycle in range(CYCLES)]
    space = problem.forecast.space
    model = Mover(space, problem.forecast.members, None if still else growth(space.size))
    arrivals = [(Observation(each.values, each.operator, cycle + model.dt),) for cycle, each in enumerate(problems)]
    return SmallStudy(model, tuple(arrivals))


def after(cycle: Cycle) -> Ensemble:
    """Return the belief after a cycle, with its weights."""
    return cycle.state.belief.ensemble


def reread(state: State) -> State:
    """Return the state after a round trip through a file: new copies of its arrays."""
    return replace(
        state,
        belief=_reread(state.belief),
        filter_memory=restored(state.filter_memory),
        past=tuple(_reread_past(one) for one in state.past),
    )


def _reread(belief: Forecast) -> Forecast:
    ensemble = belief.ensemble
    weights = None if ensemble.weights is None else ensemble.weights.copy()
    return Forecast(Ensemble(ensemble.members.copy(), ensemble.space, ensemble.time, weights), restored(belief.memory))


def _reread_past(cycle: PastCycle) -> PastCycle:
    old = cycle.observation
    observation = Observation(old.values.copy(), pickle.loads(pickle.dumps(old.operator)), old.time)
    return PastCycle(cycle.number, None if cycle.belief is None else _reread(cycle.belief), observation)


def require_same_cycles(first: Sequence[Cycle], second: Sequence[Cycle], message: str) -> None:
    """Raise ConformanceError unless the analyses of two runs agree to the last bit."""
    for number, (one, other) in enumerate(zip(first, second, strict=True), 1):
        where = f"analysis {number}: {message}"
        require_same_bits(one.analysis.members, other.analysis.members, where)
        require_same_bits(after(one).weights, after(other).weights, f"{where}, in the weights")
        revised = [
            {str(done): _bits(belief) for done, belief in each.analysis.revised.items()} for each in (one, other)
        ]
        require_same_bits(revised[0], revised[1], f"{where}, in the revised beliefs")
    last = first[-1].state, second[-1].state
    require_same_bits(last[0].filter_memory, last[1].filter_memory, f"{message}, in the filter's memory")
    require_same_bits(last[0].belief.memory, last[1].belief.memory, f"{message}, in the model's memory")


def _bits(belief: Forecast) -> dict[str, bytes]:
    parts = {"members": belief.ensemble.members, "weights": belief.ensemble.weights, "memory": belief.memory}
    return {name: frozen(part) for name, part in parts.items()}


def watched(filter_: Filter, named: Callable[..., dict[str, Any]]) -> Filter:
    """Make the filter raise ConformanceError if an analysis changes its arguments, and return it.

    ``named(*arguments)`` takes the arguments of ``update`` or ``look_back`` without the generator. It returns those
    that must not change, keyed by their names in messages.
    """
    for verb in ("update", "look_back"):
        setattr(filter_, verb, partial(_watched, getattr(filter_, verb), named))
    return filter_


def _watched(analyse: Callable[..., Analysis], named: Callable[..., dict[str, Any]], *arguments: Any) -> Analysis:
    before = {name: frozen(part) for name, part in named(*arguments[:-1]).items()}
    analysis = analyse(*arguments)
    changed = [name for name, part in named(*arguments[:-1]).items() if frozen(part) != before[name]]
    require(not changed, f"an analysis changed {', '.join(changed)}")
    return analysis
