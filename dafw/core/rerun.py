"""Running the model again: any members, from any cycle to any later one, through the study's executor.

With the belief's own random streams a re-run of the belief's members repeats the belief bit for bit, model error
included. Under another role, such as planning, the streams are different ones. A ``Rerun`` gives access to the model
alone: neither the truth nor the noise of its readings can be reached through it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from dafw.core.domain import Domain
from dafw.core.ensemble import Ensemble, Forecast
from dafw.core.errors import ContractError
from dafw.core.executors import Executor
from dafw.core.executors.batches import Batch, Stepped
from dafw.core.executors.serial import Serial
from dafw.core.interfaces.model import Model
from dafw.core.interpolation import View, view
from dafw.core.observation import ObservationOperator
from dafw.core.rng import Streams
from dafw.core.space import Array, StateSpace
from dafw.core.spans import Means

MODEL_ERROR = "model error"
"""The role of the belief's own streams."""


@dataclass(frozen=True, eq=False)
class Replay:
    """The result of a re-run.

    ``forecast`` is the ensemble at the end, with the model's memory. ``predicted`` are the readings (N, m) that the
    members predict, keyed by the number of the cycle at whose end they are taken. ``states`` are the ensembles after
    every cycle, if they were asked for.
    """

    forecast: Forecast
    predicted: Mapping[int, Array] = field(default_factory=dict)
    states: tuple[Forecast, ...] = ()

    def stacked(self) -> Array:
        """Return all predicted readings side by side (N, M), in the order of the cycles."""
        columns = [self.predicted[cycle] for cycle in sorted(self.predicted)]
        n_members = len(self.forecast.ensemble)
        return np.concatenate(columns, axis=1) if columns else np.empty((n_members, 0))


@dataclass(frozen=True, eq=False)
class Rerun:
    """Runs the model again: ``rerun(start, 0, 5)`` steps the members of ``start`` through cycles 0 to 4."""

    _model: Model
    _executor: Executor
    _streams: Streams

    def __call__(
        self,
        start: Forecast | Ensemble,
        first: int,
        last: int,
        *,
        operators: Mapping[int, ObservationOperator] | None = None,
        role: str = MODEL_ERROR,
        keep: bool = False,
    ) -> Replay:
        """Run and wait; the arguments are those of ``begin``."""
        return self.begin(start, first, last, operators=operators, role=role, keep=keep)()

    def begin(
        self,
        start: Forecast | Ensemble,
        first: int,
        last: int,
        *,
        operators: Mapping[int, ObservationOperator] | None = None,
        role: str = MODEL_ERROR,
        keep: bool = False,
    ) -> Callable[[], Replay]:
        """Start a run of the members of ``start`` from the beginning of cycle ``first`` to that of cycle ``last``.

        Return a function that waits for the Replay and returns it; several runs may be under way at once.

        start      an ensemble of any number of members at the beginning of cycle ``first``, with the model's memory
                   for these members, if there is one; otherwise the model makes a new one
        operators  observation operators, keyed by the number of the cycle at whose end they are applied; of readings
                   with a span (``ObservationOperator.spans``) the mean over the cycles of the span is predicted
        role       the name of the random streams; by default the belief's own
        keep       return the ensembles after all cycles

        Raises ContractError if ``last`` is before ``first``, an operator belongs to none of the cycles, or the members
        have another state space.
        """
        if last <= first or first < 0:
            raise ContractError(f"a re-run must go from a cycle to a later one, got {first} to {last}")
        if outside := [cycle for cycle in operators or {} if not first <= cycle < last]:
            raise ContractError(f"a re-run of cycles {first} to {last - 1} has an operator for cycle {outside[0]}")
        means = Means(operators or {}, first, self._model.dt)
        wanted = {cycle - first + 1: operator for cycle, operator in means.applied.items()}
        members = (start if isinstance(start, Ensemble) else start.ensemble).members
        if members.ndim != 2 or members.shape[1] != self._model.space.size:
            raise ContractError(
                f"{self._model.label}: a re-run needs members (N, {self._model.space.size}), got {members.shape}"
            )
        if isinstance(start, Ensemble):
            start = self.with_memory(start)
        ensemble = start.ensemble
        # The prefix keeps other roles apart from the study's own: no role can name the streams of the truth or noise.
        rng = self._streams.members(role if role == MODEL_ERROR else f"rerun {role}", first)
        batch = Batch(ensemble.members, start.memory, ensemble.time, rng, last - first, wanted, keep)
        stepped = self._executor.submit(self._model, batch)
        return lambda: self._replay(ensemble, first, last, stepped(), means, keep)

    @cached_property
    def coarser(self) -> Rerun:
        """What runs the coarser version of the model, in this process; raises ConfigurationError if there is none."""
        return Rerun(self._model.coarser(), Serial(), self._streams)

    @cached_property
    def view_of_coarser(self) -> View | None:
        """The map from states of the coarser version to those of the model; None if they are the same."""
        coarser = self.coarser
        return view(coarser.space, coarser.domain, self.space, "coarser model")

    @cached_property
    def view_to_coarser(self) -> View | None:
        """The map from states of the model to those of the coarser version; None if they are the same."""
        return view(self.space, self.domain, self.coarser.space, "model")

    @property
    def space(self) -> StateSpace:
        """The model's state space."""
        return self._model.space

    @property
    def dt(self) -> float:
        """The time of a cycle in seconds."""
        return self._model.dt

    @property
    def domain(self) -> Domain | None:
        """The model's domain, with its obstacles; None if its state has no places."""
        return self._model.domain

    def with_memory(self, ensemble: Ensemble) -> Forecast:
        """Return an ensemble with the memory that the model makes for members that it has not stepped yet."""
        return Forecast(ensemble, self._model.initial_memory(ensemble.members))

    def settled(self, ensemble: Ensemble) -> Ensemble:
        """Return an ensemble at the start with its fields recomputed from its parameters (``Model.settled``)."""
        return ensemble.with_members(self.settled_members(ensemble.members))

    def settled_members(self, members: Array) -> Array:
        """Return members (N, n) at the start with their fields recomputed from their parameters."""
        return self._model.checked(self._model.settled(members), members.shape, "settled members")

    def first_guess(self, n_members: int, role: str, number: int) -> Ensemble:
        """Return draws from the first guess; every pair of a ``role`` and a ``number`` has streams of its own."""
        return self._model.first_guess(n_members, self._streams.members(f"rerun {role}", number)).ensemble

    def log_first_guess(self, members: Array, *, drawn: bool = False) -> Array:
        """Return the log density (N,) of the first guess at members (N, n) at the start (``Model.log_first_guess``).

        Raises ConfigurationError if the model does not know it, and ContractError if it calls members impossible that
        it has ``drawn`` itself.
        """
        return self._model.checked_log_density(members, drawn=drawn)

    def _replay(self, ensemble: Ensemble, first: int, last: int, stepped: Stepped, means: Means, keep: bool) -> Replay:
        """Check and wrap the executor's result."""
        times = [ensemble.time]
        for _ in range(first, last):
            times.append(times[-1] + self._model.dt)  # the same sum as in the cycles, so that the bits agree
        times = times[-len(stepped.steps) - 1 :]
        states = []
        for time, step in zip(times[:-1], stepped.steps, strict=True):
            before = Ensemble(ensemble.members, ensemble.space, time, ensemble.weights)
            states.append(self._model.stepped(before, step))
        predicted = {number + first - 1: values for number, values in stepped.predicted.items()}
        return Replay(states[-1], means.of(predicted), tuple(states) if keep else ())
