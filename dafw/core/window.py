"""What filters that look back and policies that look ahead are handed: ``Window`` and ``Outlook``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from dafw.core.ensemble import Ensemble, Forecast, Memory, Vehicle
from dafw.core.errors import ContractError
from dafw.core.observation import Observation, ObservationOperator, block_diagonal, merged_observations
from dafw.core.space import Array

if TYPE_CHECKING:
    from dafw.core.rerun import Replay, Rerun


@dataclass(frozen=True, eq=False)
class PastCycle:
    """One cycle of the past: what was believed at its beginning, and what was read until its end.

    ``number`` counts the cycles from 0. ``belief`` is as the filter last revised it, with the model's memory; None
    where the filter does not need it. ``observation`` holds the readings known by now, late ones included; it has no
    values in a silent cycle.
    """

    number: int
    belief: Forecast | None
    observation: Observation

    def with_readings(self, late: Observation) -> PastCycle:
        """Return the cycle with late readings added to those that it had."""
        added = [one for one in (self.observation, late) if one.values.size]
        return replace(self, observation=merged_observations(added, self.observation.time))

    def with_belief(self, belief: Forecast | None) -> PastCycle:
        """Return the cycle with another belief at its beginning."""
        return self if belief is self.belief else replace(self, belief=belief)


@dataclass(frozen=True, eq=False)
class Window:
    """What a filter that looks back is handed.

    ``cycles`` are the cycles of the window, the present one last. ``forecast`` is the ensemble at the end of the
    present cycle, with the model's memory; its members predict ``predicted`` (N, m) of the present ``observation``.
    ``late`` are readings that arrived in this cycle and belong to earlier ones, by the cycle's number; they are in
    ``cycles`` already. ``memory`` is the filter's own, ``rerun`` runs the model again.
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
        """The belief at the beginning of the window; raises ContractError where the filter asked for none."""
        belief = self.cycles[0].belief
        if belief is None:
            raise ContractError("the window holds no belief at its beginning")
        return belief

    def belief_after(self, number: int) -> Forecast:
        """Return the belief at the end of cycle ``number``: the forecast after the present one.

        Raises ContractError where the window does not hold it.
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
        are the predictions (N, M) of ``values``.
        """
        operators = {cycle.number: cycle.observation.operator for cycle in self.cycles}
        first, last = self.cycles[0].number, self.cycles[-1].number + 1
        return self.rerun(self.first if start is None else start, first, last, operators=operators)


@dataclass(frozen=True, eq=False)
class Outlook:
    """What a policy that looks ahead is handed: the belief with the model's memory, the vehicle, and a view ahead.

    ``cycle`` is the number of the cycle that begins; ``memory`` is the policy's own.
    """

    belief: Forecast
    vehicle: Vehicle
    memory: Memory | None
    cycle: int
    rerun: Rerun

    def ahead(
        self, n_cycles: int, operators: Sequence[ObservationOperator] | None = None, *, members: Array | None = None
    ) -> Replay:
        """Run the belief on for ``n_cycles`` cycles, in random streams that are for planning alone.

        ``operators``, one for each cycle, are what would be read at the end of it: the result's ``predicted`` holds
        the readings by the number of the cycle. Without operators the result's ``states`` are the ensembles after
        each cycle. ``members`` (M, n) run on instead of the belief's, with the model's memory made anew.
        """
        start = self.belief if members is None else self.belief.ensemble.with_members(members)
        last = self.cycle + n_cycles
        wanted = None if operators is None else dict(zip(range(self.cycle, last), operators, strict=True))
        return self.rerun(start, self.cycle, last, operators=wanted, role="planning", keep=operators is None)
