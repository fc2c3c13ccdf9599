"""Running the model again: any members, from any cycle to any later one, through the study's executor.

With the belief's own random streams a re-run of the belief's members gives the belief's bits, model error included.
Under another role the streams are others, as for planning. Whoever holds a ``Rerun`` can reach the model and nothing
else: neither the truth nor the noise of its readings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from dafw.core.ensemble import Ensemble, Forecast
from dafw.core.errors import ContractError
from dafw.core.executors import Executor
from dafw.core.executors.batches import Batch, Stepped
from dafw.core.interfaces.model import Model
from dafw.core.observation import ObservationOperator
from dafw.core.rng import Streams
from dafw.core.space import Array

MODEL_ERROR = "model error"
"""The role of the belief's own streams."""


@dataclass(frozen=True, eq=False)
class Replay:
    """What a re-run gives.

    ``forecast`` is the ensemble at the end, with the model's memory; ``predicted`` are the readings (N, m) that the
    members would have given, by the number of the cycle at whose end they were taken; ``states`` are the ensembles
    after every cycle where they were asked for.
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
        """Begin to run the members of ``start`` from the beginning of cycle ``first`` to that of cycle ``last``.

        Calling what comes back waits for the Replay; several may be under way at once.

        start      an ensemble of any number of members at the beginning of cycle ``first``, with the model's memory
                   where it has one that goes with them; without, the model makes a new one
        operators  by the number of a cycle: what is read of the members at its end
        role       the name of the random streams; the default are the belief's own
        keep       hand out the ensembles after all cycles

        Raises ContractError where the cycles are in no order, an operator belongs to none of them, or the members are
        of another state.
        """
        if last <= first or first < 0:
            raise ContractError(f"a re-run must go from a cycle to a later one, got {first} to {last}")
        wanted = {cycle - first + 1: operator for cycle, operator in (operators or {}).items()}
        if outside := [cycle for cycle in operators or {} if not first <= cycle < last]:
            raise ContractError(f"a re-run of cycles {first} to {last - 1} has an operator for cycle {outside[0]}")
        members = (start if isinstance(start, Ensemble) else start.ensemble).members
        if members.ndim != 2 or members.shape[1] != self._model.space.size:
            raise ContractError(
                f"{self._model.label}: a re-run needs members (N, {self._model.space.size}), got {members.shape}"
            )
        if isinstance(start, Ensemble):
            start = Forecast(start, self._model.initial_memory(start.members))
        ensemble = start.ensemble
        # A name of its own for every other role: nobody can ask for the truth's streams or for those of its noise.
        rng = self._streams.members(role if role == MODEL_ERROR else f"rerun {role}", first)
        batch = Batch(ensemble.members, start.memory, ensemble.time, rng, last - first, wanted, keep)
        stepped = self._executor.submit(self._model, batch)
        return lambda: self._replay(ensemble, first, last, stepped(), keep)

    def settled(self, ensemble: Ensemble) -> Ensemble:
        """Return an ensemble at the start with the fields that follow from its single numbers."""
        members = self._model.settled(ensemble.members)
        return ensemble.with_members(self._model.checked(members, ensemble.members.shape, "settled members"))

    def _replay(self, ensemble: Ensemble, first: int, last: int, stepped: Stepped, keep: bool) -> Replay:
        """Check and wrap what the executor gave."""
        times = [ensemble.time]
        for _ in range(first, last):
            times.append(times[-1] + self._model.dt)  # summed as the cycles sum it
        times = times[-len(stepped.steps) - 1 :]
        states = []
        for time, step in zip(times[:-1], stepped.steps, strict=True):
            before = Ensemble(ensemble.members, ensemble.space, time, ensemble.weights)
            states.append(self._model.stepped(before, step))
        predicted = {number + first - 1: values for number, values in stepped.predicted.items()}
        return Replay(states[-1], predicted, tuple(states) if keep else ())
