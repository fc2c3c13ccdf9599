"""The arguments of filters that look back and of policies that look ahead: ``Window`` and ``Outlook``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from dafw.core.covariances import block_diagonal
from dafw.core.ensemble import Ensemble, Forecast, Memory, Vehicle
from dafw.core.errors import ContractError
from dafw.core.observation import Observation, ObservationOperator, merged_observations
from dafw.core.space import Array

if TYPE_CHECKING:
    from dafw.core.rerun import Replay, Rerun


@dataclass(frozen=True, eq=False)
class PastCycle:
    """One cycle of the past: the belief at its beginning, and the readings up to its end.

    ``number`` counts the cycles from 0. ``belief`` is the belief as last revised, with the model's memory; None if
    the filter does not need it. ``observation`` holds the readings known by now, late ones included; it is empty for
    a cycle without readings.
    """

    number: int
    belief: Forecast | None
    observation: Observation

    def with_readings(self, late: Observation) -> PastCycle:
        """Return the cycle with late readings added."""
        added = [one for one in (self.observation, late) if one.values.size]
        return replace(self, observation=merged_observations(added, self.observation.time))

    def with_belief(self, belief: Forecast | None) -> PastCycle:
        """Return the cycle with another belief at its beginning."""
        return self if belief is self.belief else replace(self, belief=belief)


@dataclass(frozen=True, eq=False)
class Window:
    """The argument of a filter that looks back.

    ``cycles`` are the cycles of the window, the present one last. ``forecast`` is the ensemble at the end of the
    present cycle, with the model's memory; its members predict ``predicted`` (N, m) of the present ``observation``.
    ``late`` are readings that arrived in this cycle and belong to earlier ones, keyed by the cycle's number; ``cycles``
    contain them already. ``memory`` is the filter's own, ``rerun`` runs the model again.
    """

    cycles: tuple[PastCycle, ...]
    forecast: Forecast
    predicted: Array
    late: tuple[tuple[int, Observation], ...]
    memory: Memory | None
    rerun: Rerun

    @property
    def observation(self) -> Observation:
        """The readings of the present cycle."""
        return self.cycles[-1].observation

    @property
    def first(self) -> Forecast:
        """The belief at the beginning of the window; raises ContractError if the filter did not ask for it."""
        belief = self.cycles[0].belief
        if belief is None:
            raise ContractError("the window holds no belief at its beginning")
        return belief

    def belief_after(self, number: int) -> Forecast:
        """Return the belief at the end of cycle ``number``; at the end of the present cycle it is the forecast.

        Raises ContractError if the window does not hold it.
        """
        place = number + 1 - self.cycles[0].number
        belief = self.forecast if place == len(self.cycles) else None
        if 0 <= place < len(self.cycles):
            belief = self.cycles[place].belief
        if belief is None:
            raise ContractError(f"the window holds no belief after cycle {number}")
        return belief

    @property
    def values(self) -> Array:
        """All readings of the window (M,), in the order of the cycles."""
        return np.concatenate([cycle.observation.values for cycle in self.cycles])

    @property
    def covariance(self) -> Array:
        """R of all readings of the window: (M,) where diagonal, else (M, M)."""
        return block_diagonal([cycle.observation.covariance for cycle in self.cycles])

    def replay(self, start: Forecast | Ensemble | None = None) -> Replay:
        """Run members from the beginning of the window to now, and predict all its readings.

        ``start`` is an ensemble at the beginning of the window; None: the belief there. ``stacked()`` of the result
        returns the predictions (N, M) of ``values``.
        """
        operators = {cycle.number: cycle.observation.operator for cycle in self.cycles}
        first, last = self.cycles[0].number, self.cycles[-1].number + 1
        return self.rerun(self.first if start is None else start, first, last, operators=operators)


@dataclass(frozen=True, eq=False)
class Outlook:
    """The argument of a policy that looks ahead: the belief with the model's memory, the vehicle, and forecasts.

    ``cycle`` is the number of the cycle that begins; ``memory`` is the policy's own.
    """

    belief: Forecast
    vehicle: Vehicle
    memory: Memory | None
    cycle: int
    rerun: Rerun

    def on_coarser(self) -> Outlook:
        """Return the same outlook with the coarser version of the model, which has a new memory for the members.

        Raises ConfigurationError if there is none.
        """
        coarser, shown = self.rerun.coarser, self.rerun.view_to_coarser
        ensemble = self.belief.ensemble if shown is None else shown.of(self.belief.ensemble)
        return replace(self, belief=coarser.with_memory(ensemble), rerun=coarser)

    def ahead(
        self, n_cycles: int, operators: Sequence[ObservationOperator] | None = None, *, members: Array | None = None
    ) -> Replay:
        """Forecast the belief for ``n_cycles`` cycles, with random streams that are used for planning alone.

        ``operators``, one for each cycle, are applied at the end of it; ``predicted`` of the result holds the
        readings, keyed by the number of the cycle. Without operators ``states`` of the result are the ensembles after
        each cycle. If ``members`` (M, n) are given, they are forecast instead of the belief's, with new model memory.
        """
        start = self.belief if members is None else self.belief.ensemble.with_members(members)
        last = self.cycle + n_cycles
        wanted = None if operators is None else dict(zip(range(self.cycle, last), operators, strict=True))
        return self.rerun(start, self.cycle, last, operators=wanted, role="planning", keep=operators is None)
