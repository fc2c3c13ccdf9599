"""The four interfaces: Model, Observer, Policy, Filter.

An author's verb computes (``step``, ``operator``, ``decide``, ``analyse``); the user's verb on the base class
(``forecast``, ``look``, ``route``, ``update``) hands it read-only arrays, checks what comes back (shape, finiteness,
space) and names the plugin in its error.

Whatever a plugin must remember is explicit. A plugin that remembers overrides ``initial_memory`` and the verb whose
name ends in ``_with_memory``; one that does not never hears of it. Random numbers come from the generator handed in.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise, starmap
from math import dist
from typing import Any, ClassVar

import numpy as np

from dafw.core.domain import Domain
from dafw.core.ensemble import Analysis, Ensemble, Forecast, Memory, Route, Step, Vehicle
from dafw.core.errors import ConfigurationError, ContractError
from dafw.core.observation import Observation, ObservationOperator
from dafw.core.plugin import Plugin
from dafw.core.rng import MemberStreams
from dafw.core.space import Array, StateSpace


class Model(Plugin):
    """How the state evolves from t to t + dt, and what a first guess of it is.

    Authors set ``space`` and ``dt`` (seconds), and ``domain`` where the state has places, and define ``initial`` and
    ``step`` (or ``step_with_memory``).

    >>> class Decay(Model):
    ...     space, dt = StateSpace([Variable("level", 2)]), 1.0
    ...     def initial(self, n_members, rng): return rng.standard_normal((n_members, 2))
    ...     def step(self, members, t, rng): return 0.5 * members
    >>> Decay().forecast(Ensemble([[2.0, 4.0]], Decay.space), None, None).ensemble.members
    array([[1., 2.]])
    """

    kind = "model"
    space: StateSpace
    dt: float
    domain: Domain | None = None

    def initial(self, n_members: int, rng: MemberStreams) -> Array:
        """Return draws (N, n) from the first guess; row i from ``rng[i]`` alone."""
        raise NotImplementedError(f"{self.label} must define initial(n_members, rng)")

    def step(self, members: Array, t: float, rng: MemberStreams) -> Array:
        """Return the members (N, n) at t + dt, model error included."""
        raise NotImplementedError(f"{self.label} must define step(members, t, rng)")

    def notes(self) -> list[str]:
        """Return sentences for the log about what the model was made of."""
        return []

    def share(self, communicator: Any) -> None:
        """Share the work of every step with the other ranks of an MPI communicator; called before anything else.

        All ranks then call the same in the same order, and every one gets the whole result. Raises ConfigurationError:
        a model that says nothing else works in one process.
        """
        raise ConfigurationError(f"{self.label} works in one process: mpirun brings nothing, run it without")

    def require_available(self) -> None:
        """Raise ConfigurationError where something that the options name is not there; asked before a run begins."""

    def pinned_options(self) -> Mapping[str, Any]:
        """Return options to lay over the configured ones so that other processes make the very same model.

        That is what a configuration leaves open: "the newest basis" is by now one of a certain name.
        """
        return {}

    def initial_memory(self, members: Array) -> Memory | None:
        """Return what a step of these members (N, n) must be told; arrays have the members on axis 0."""
        return None

    def step_with_memory(self, members: Array, memory: Memory | None, t: float, rng: MemberStreams) -> Step:
        """Return the step of a model that remembers."""
        return Step(self.step(members, t, rng))

    def first_guess(self, n_members: int, rng: MemberStreams) -> Forecast:
        """Draw, check and wrap the initial ensemble; raises ContractError."""
        members = self.checked(self.initial(n_members, rng), (n_members, self.space.size), "initial members")
        return Forecast(Ensemble(members, self.space), self.initial_memory(members))

    def forecast(self, ensemble: Ensemble, memory: Memory | None, rng: MemberStreams) -> Forecast:
        """Step the ensemble by dt; raises ContractError where shape or numbers are not as agreed."""
        return self.stepped(ensemble, self.step_with_memory(ensemble.members, memory, ensemble.time, rng))

    def stepped(self, ensemble: Ensemble, step: Step) -> Forecast:
        """Check and wrap what a step of the ensemble gave, whoever took it; raises ContractError."""
        members = self.checked(step.members, ensemble.members.shape, "members after a step")
        self.checked_diagnostics(step.diagnostics)
        return Forecast(Ensemble(members, self.space, ensemble.time + self.dt), step.memory, step.diagnostics)


class Observer(Plugin):
    """What instruments would read, and how well.

    >>> class First(Observer):
    ...     def operator(self, space, route, t):
    ...         return Selection(indices=np.array([0]), covariance=np.array([0.01]))
    >>> space = StateSpace([Variable("level", 2)])
    >>> First().look(space, Route(), 0.0).apply(np.array([[2.0, 4.0]]))
    array([[2.]])
    """

    kind = "observer"

    @classmethod
    def check_space(cls) -> StateSpace | None:
        """Return a small state space that the checks use; None: their own, with ``concentration`` and a wind."""
        return None

    def operator(self, space: StateSpace, route: Route, t: float) -> ObservationOperator:
        """Return H and R of the readings of a state in ``space`` taken along ``route``, which begins at t (seconds)."""
        raise NotImplementedError(f"{self.label} must define operator(space, route, t)")

    def suit(self, space: StateSpace, dt: float) -> None:
        """Raise ConfigurationError where the options do not go with a state space and a time step (seconds)."""

    def look(self, space: StateSpace, route: Route, t: float) -> ObservationOperator:
        """Ask for the operator and check that it is one; raises ContractError."""
        operator = self.operator(space, route, t)
        if not isinstance(operator, ObservationOperator):
            raise ContractError(f"{self.label}: expected an ObservationOperator, got {type(operator).__name__}")
        return operator

    def read(self, operator: ObservationOperator, ensemble: Ensemble) -> Array:
        """Return what each member would read (N, m), checked; raises ContractError."""
        return self.checked(operator.apply(ensemble.members), (len(ensemble), operator.size), "predicted readings")


class Policy(Plugin):
    """Where the instruments go next, knowing only the belief and the vehicle.

    >>> class East(Policy):
    ...     def decide(self, belief, vehicle, rng):
    ...         return Route(tuple(np.array([p, p + [vehicle.reach, 0.0]]) for p in vehicle.positions))
    >>> vehicle = Vehicle(np.array([[0.0, 0.0]]), speed=10.0)
    >>> East().route(None, vehicle, None, None).ends
    array([[10.,  0.]])
    """

    kind = "policy"

    @classmethod
    def check_space(cls) -> StateSpace | None:
        """Return a small state space that the checks use; None: their own, with ``concentration`` and a wind."""
        return None

    def decide(self, belief: Ensemble, vehicle: Vehicle, rng: np.random.Generator) -> Route:
        """Return the route until the next decision."""
        raise NotImplementedError(f"{self.label} must define decide(belief, vehicle, rng)")

    def suit(self, space: StateSpace) -> None:
        """Raise ConfigurationError where the options do not go with a state space."""

    def initial_memory(self, vehicle: Vehicle) -> Memory | None:
        """Return what the first decision must be told."""
        return None

    def decide_with_memory(
        self, belief: Ensemble, vehicle: Vehicle, memory: Memory | None, rng: np.random.Generator
    ) -> Route:
        """Return the route of a policy that remembers."""
        return self.decide(belief, vehicle, rng)

    def route(self, belief: Ensemble, vehicle: Vehicle, memory: Memory | None, rng: np.random.Generator) -> Route:
        """Ask for a route and check it: it begins at the vehicles, and no vehicle flies farther than it can."""
        route = self.decide_with_memory(belief, vehicle, memory, rng)
        if not isinstance(route, Route):
            raise ContractError(f"{self.label}: expected a Route, got {type(route).__name__}")
        if len(route.paths) != len(vehicle.positions):
            raise ContractError(f"{self.label}: {len(vehicle.positions)} vehicles, but {len(route.paths)} paths")
        for number, (path, position) in enumerate(zip(route.paths, vehicle.positions, strict=True)):
            self.checked(path, path.shape, f"the path of vehicle {number}")
            if len(path) == 0 or path[0].tolist() != position.tolist():
                raise ContractError(f"{self.label}: the path of vehicle {number} does not begin at {position.tolist()}")
            flown = sum(starmap(dist, pairwise(path.tolist())))
            if flown > vehicle.reach * (1.0 + 1e-9):
                raise ContractError(
                    f"{self.label}: vehicle {number} would fly {flown:.6g} m, it can fly {vehicle.reach:.6g} m"
                )
            for leg in pairwise(path):
                if vehicle.airspace is not None and not vehicle.airspace.is_free(*leg):
                    raise ContractError(
                        f"{self.label}: vehicle {number} would fly out of the domain or into a building on its way "
                        f"from {leg[0].tolist()} to {leg[1].tolist()}"
                    )
        self.checked_diagnostics(route.diagnostics)
        return route


class Filter(Plugin):
    """How the belief changes once the readings are in.

    ``accuracy`` says how the mean and covariance of an analysis agree with the Kalman filter's where all is linear and
    Gaussian: ``exact`` for the sample at hand, ``statistical`` in the limit of many members, or ``none``: no claim.
    ``localization_option`` names the option that is the localization radius in metres, where there is one.

    >>> class Midway(Filter):
    ...     def analyse(self, forecast, predicted, observation, rng):
    ...         missed = (observation.values - predicted).mean(axis=1, keepdims=True)
    ...         return Analysis(forecast.space.retract(forecast.members, 0.5 * missed))
    >>> belief = Ensemble([[0.0], [2.0]], StateSpace([Variable("level", 1)]))
    >>> seen = Observation([3.0], Selection(indices=np.array([0]), covariance=np.array([1.0])))
    >>> Midway().update(belief, np.array(belief.members), seen, None, None).members
    array([[1.5],
           [2.5]])
    """

    kind = "filter"
    smallest_ensemble: ClassVar[int] = 2
    accuracy: ClassVar[str] = "statistical"
    localization_option: ClassVar[str | None] = None

    def analyse(
        self, forecast: Ensemble, predicted: Array, observation: Observation, rng: np.random.Generator
    ) -> Analysis:
        """Return the analysis of a forecast whose members predict the readings ``predicted`` (N, m)."""
        raise NotImplementedError(f"{self.label} must define analyse(forecast, predicted, observation, rng)")

    def initial_memory(self, n_members: int) -> Memory | None:
        """Return what the first analysis must be told."""
        return None

    def analyse_with_memory(
        self,
        forecast: Ensemble,
        predicted: Array,
        observation: Observation,
        memory: Memory | None,
        rng: np.random.Generator,
    ) -> Analysis:
        """Return the analysis of a filter that remembers."""
        return self.analyse(forecast, predicted, observation, rng)

    def suit(self, space: StateSpace, n_members: int) -> None:
        """Raise ConfigurationError where the filter does not go with a state space or a number of members."""

    def require_members(self, n_members: int) -> None:
        """Raise ConfigurationError where the filter cannot work with so few members."""
        if n_members < self.smallest_ensemble:
            raise ConfigurationError(
                f"{self.label} needs at least {self.smallest_ensemble} members, the study has {n_members}"
            )

    def update(
        self,
        forecast: Ensemble,
        predicted: Array,
        observation: Observation,
        memory: Memory | None,
        rng: np.random.Generator,
    ) -> Analysis:
        """Analyse and check; with no readings at all the forecast, brought into the state's set, is the analysis."""
        if observation.values.size == 0:
            return Analysis(forecast.space.retract(forecast.members, np.zeros(forecast.space.size)), memory)
        predicted = self.checked(predicted, (len(forecast), observation.values.size), "predicted readings")
        predicted.setflags(write=False)
        analysis = self.analyse_with_memory(forecast, predicted, observation, memory, rng)
        if not isinstance(analysis, Analysis):
            raise ContractError(f"{self.label}: expected an Analysis, got {type(analysis).__name__}")
        members = self.checked(analysis.members, forecast.members.shape, "members after the analysis")
        self.checked_diagnostics(analysis.diagnostics)
        return Analysis(members, analysis.memory, analysis.diagnostics)
