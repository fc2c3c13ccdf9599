"""Sorting readings by the cycle that they belong to: those of now, late ones, and those that come to nothing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dafw.core.interfaces.readings import Request
from dafw.core.observation import Observation, merged_observations
from dafw.core.space import Array

LATE_CHOICES = ("drop", "use")
FORGIVEN = 1e-6
"""Share of a time step by which the time of a reading may be off: times of cycles are sums of rounded steps."""
USES = ("on_time", "late_in_window", "late_used_now", "late_dropped", "before_start")
"""What becomes of a reading."""
NONE = dict.fromkeys(USES, 0)


@dataclass(frozen=True, eq=False)
class Sorted:
    """Readings by what becomes of them.

    ``now`` are those that are used at the end of this cycle, whose own times (m,) in seconds are ``times``; ``late``
    those of earlier cycles by the cycle's number, and ``dropped`` those that nobody can use any more. ``counts`` says
    how many readings there were of each kind: ``on_time``, ``late_in_window``, ``late_used_now``, ``late_dropped``,
    ``before_start``.
    """

    now: Observation
    times: Array
    late: tuple[tuple[int, Observation], ...] = ()
    dropped: tuple[Observation, ...] = ()
    counts: dict[str, int] = field(default_factory=dict)


def sort_by_cycle(
    observations: Sequence[Observation], request: Request, dt: float, reach: Sequence[int], late_readings: str
) -> Sorted:
    """Return the readings of a cycle, sorted.

    A reading belongs to the cycle in whose time (start, end] it was taken. ``reach`` are the numbers of the cycles that
    the filter's window holds, the present one last; ``late_readings`` is what becomes of those before them: ``use`` as
    if they were of now, or ``drop``. A reading from before the first cycle is dropped: it is about another time than
    the study's.
    """
    if len(observations) == 1 and observations[0].time == request.end:  # as in every cycle of a twin
        one = observations[0]
        return Sorted(one, np.full(one.values.size, one.time), counts={**NONE, "on_time": one.values.size})
    now: list[Observation] = []
    late: list[tuple[int, Observation]] = []
    dropped: list[Observation] = []
    counts = {**NONE}
    for observation in observations:
        cycle = request.cycle - max(0, math.floor((request.end - observation.time) / dt + FORGIVEN))
        size = observation.values.size
        if cycle == request.cycle:
            now.append(observation)
            counts["on_time"] += size
        elif cycle < 0:
            dropped.append(observation)
            counts["before_start"] += size
        elif cycle in reach:
            late.append((cycle, observation))
            counts["late_in_window"] += size
        elif late_readings == "use":
            now.append(observation)
            counts["late_used_now"] += size
        else:
            dropped.append(observation)
            counts["late_dropped"] += size
    times = np.concatenate([np.full(one.values.size, one.time) for one in now]) if now else np.empty(0)
    return Sorted(merged_observations(now, request.end), times, tuple(late), tuple(dropped), counts)
