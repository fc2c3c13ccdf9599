"""Filters that look back: ensemble Kalman smoothers with one fault each."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from broken.registry import breaks
from dafw import ObservationOperator
from dafw.plugins.filters.enks import EnKS


@breaks("revised_in_set")
class BelowZero(EnKS):
    """In beliefs of earlier times, numbers that should be cut off at zero are slightly below zero."""

    def analyse_window(self, window, rng):
        right = super().analyse_window(window, rng)
        revised = {}
        for done, belief in right.revised.items():
            members = belief.ensemble.members
            revised[done] = belief.with_members(np.where(members == 0.0, -1e-3, members))
        return replace(right, revised=revised)


class RevisesTheStart(EnKS):
    """Returns a belief at the start of the study, even if its window begins later."""

    def analyse_window(self, window, rng):
        right = super().analyse_window(window, rng)
        return replace(right, revised={**right.revised, 0: window.first})


@breaks("past_unchanged")
class WritesIntoTheModelsMemory(EnKS):
    def analyse_window(self, window, rng):
        for memory in [window.forecast.memory, *(cycle.belief.memory for cycle in window.cycles)]:
            if memory is not None:
                memory["drift"][:] = 0.0
        return super().analyse_window(window, rng)


@breaks("silent_cycles")
class BeginsWithAReading(EnKS):
    def analyse_window(self, window, rng):
        if window.cycles[0].number == 0:
            _ = window.cycles[0].observation.values[0]
        return super().analyse_window(window, rng)


@breaks("late_readings")
class DeafToWhatIsLate(EnKS):
    def analyse_window(self, window, rng):
        return super().analyse_window(replace(window, late=()), rng)


@breaks("late_readings")
class NeedsAPresentReading(EnKS):
    accuracy = "none"

    def analyse_window(self, window, rng):
        _ = window.observation.values[0]
        return super().analyse_window(window, rng)


@breaks("any_executor")
class AsksInItsOwnWay(EnKS):
    """Reads the members of a re-run with an operator that cannot be sent to another process."""

    def analyse_window(self, window, rng):
        @dataclass(frozen=True, eq=False, kw_only=True)
        class Mine(ObservationOperator):
            def apply(self, members):
                return members[:, :1]

        first = window.cycles[0].number
        window.rerun(window.first, first, first + 1, operators={first: Mine(covariance=np.ones(1))})
        return super().analyse_window(window, rng)


@breaks("smoother_exact")
class FourCyclesAreEnough(EnKS):
    """Returns the first belief of a longer window unchanged."""

    def analyse_window(self, window, rng):
        right = super().analyse_window(window, rng)
        if len(window.cycles) <= 4:
            return right
        return replace(right, revised={**right.revised, window.cycles[0].number: window.first})
