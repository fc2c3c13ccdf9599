"""Sensors that follow slowly what they meet: shown(t + s) = met + (shown(t) - met) exp(-s / T), from zero at t = 0."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from dafw.core.space import Array


def reading_times(sensors: Sequence[str], start: float, end: float) -> Array:
    """Return when the readings (m,) of a cycle from ``start`` to ``end`` were taken, in seconds.

    ``sensors`` (m) name the sensor of each. A sensor takes its readings at equal intervals, the last one at the end.
    """
    counts, taken = Counter(sensors), Counter[str]()
    times = np.empty(len(sensors))
    for number, sensor in enumerate(sensors):
        taken[sensor] += 1
        times[number] = start + (end - start) * taken[sensor] / counts[sensor]
    return times


def followed(met: Array, sensors: Sequence[str], times: Array, response_time: float) -> Array:
    """Return what sensors show (..., M) that meet ``met`` (..., M), in the order in which each takes its readings.

    Args:
        met: the true values, or what members predict.
        sensors: (M) the name of the sensor of each reading.
        times: (M,) in seconds.
        response_time: the time constant T in seconds; 0: they show what they meet.
    """
    if response_time == 0.0:
        return met
    shown = np.empty_like(met)
    last: dict[str, int] = {}
    for number, sensor in enumerate(sensors):
        before = last.get(sensor)
        rest, since = (0.0, 0.0) if before is None else (shown[..., before], times[before])
        decay = np.exp(-(times[number] - since) / response_time)
        shown[..., number] = met[..., number] + (rest - met[..., number]) * decay
        last[sensor] = number
    return shown
