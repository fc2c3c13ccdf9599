"""The past that a filter may look back to, from one cycle to the next."""

from __future__ import annotations

from collections.abc import Sequence

from dafw.core.ensemble import Analysis
from dafw.core.interfaces import Filter
from dafw.core.observation import Observation
from dafw.core.window import PastCycle


def with_late(past: tuple[PastCycle, ...], late: Sequence[tuple[int, Observation]]) -> tuple[PastCycle, ...]:
    """Return the past with late readings added to the cycles that they belong to."""
    cycles = {one.number: one for one in past}
    for number, observation in late:
        cycles[number] = cycles[number].with_readings(observation)
    return tuple(cycles.values())


def kept(filter_: Filter, past: Sequence[PastCycle], analysis: Analysis) -> tuple[PastCycle, ...]:
    """Return the past for the next window: with beliefs as revised, and only as many cycles as the filter asks for."""
    if filter_.window is not None:
        past = past[max(0, len(past) - (filter_.window - 1)) :]
    rest = []
    for place, one in enumerate(past):
        needed = filter_.past_beliefs == "all" or filter_.window is not None or place == 0
        rest.append(one.with_belief(analysis.revised.get(one.number, one.belief) if needed else None))
    return tuple(rest)
