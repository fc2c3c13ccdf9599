"""Sorting readings by the cycle that they belong to: present ones, late ones, and those that are dropped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dafw.core.interfaces.readings import FORGIVEN, Request
from dafw.core.observation import Observation, merged_observations
from dafw.core.space import Array

LATE_CHOICES = ("drop", "use")
USES = ("on_time", "late_in_window", "late_used_now", "late_dropped", "before_start")
"""The ways in which a reading can be used or dropped."""
NONE = dict.fromkeys(USES, 0)


@dataclass(frozen=True, eq=False)
class Sorted:
    """Readings sorted by how they are used.

    ``now`` are the readings that are used at the end of this cycle; ``times`` (m,) are the times in seconds at which
    they were taken. ``late`` are readings of earlier cycles, keyed by the cycle's number. ``dropped`` are readings
    that are not used. ``counts`` is the number of readings of each kind: ``on_time``, ``late_in_window``,
    ``late_used_now``, ``late_dropped``, ``before_start``.
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

    A reading belongs to the cycle in whose interval (start, end] it was taken. ``reach`` are the numbers of the cycles
    in the filter's window, the present one last. ``late_readings`` says what to do with readings from before the
    window: ``use`` them as if they were taken now, or ``drop`` them. A reading from before the first cycle is always
    dropped, because the study does not cover its time.
    """
    if len(observations) == 1 and observations[0].time == request.end:  # in every cycle of a twin experiment
        one = observations[0]
        times = np.empty(one.values.size)
        times.fill(one.time)
        return Sorted(one, times, counts={**NONE, "on_time": times.size})
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
