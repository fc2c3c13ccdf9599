"""Readings as they might come, made of a state of the model, for a cycle that is rehearsed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dafw.core.space import Array, Variable
from dafw.plugins.readings.feed.desk import Rules
from dafw.plugins.readings.feed.state import Reading

NODES = 10
"""Readings of a variable with many entries."""
ERROR = 1e-3
"""Standard deviation of the readings, as a share of the largest value: they say much, so that the filter has work."""


def rehearsed(
    members: Array, rules: Rules, named: Variable, end: float, *, entries: slice, paths: Mapping[str, Array] | None
) -> list[Reading]:
    """Return readings of the variable ``named`` of the first of ``members`` (N, n), at the end of a cycle (s).

    ``entries`` are those of the variable in a member. ``paths`` are lines (2, 2) by sensor that are read instead of
    places.
    """
    values = members[0, entries]
    largest = float(np.abs(values).max())
    sd = ERROR * largest if largest > 0.0 else 1.0
    return [
        Reading(end, value, sd, rules.wanted, sensor, kind, place)
        for sensor, kind, place, value in _spots(values, named.coordinates, rules, paths)
    ]


def _spots(
    values: Array, coordinates: Array | None, rules: Rules, paths: Mapping[str, Array] | None
) -> list[tuple[str, str, tuple[float, ...], float]]:
    """Return the sensor, the kind of place, the place and the value of each reading."""
    if paths is not None:
        return [(name, "", (), float(values.mean())) for name in paths]
    if rules.entries:
        return [(name, "entry", (float(at),), float(values[at])) for name, at in rules.entries.items()]
    if rules.size == 1:
        return [("", "", (), float(values[0]))]
    chosen = {*np.linspace(0, rules.size - 1, NODES).astype(int).tolist(), int(np.abs(values).argmax())}
    in_metres = coordinates is not None and "metres" in rules.places
    return [
        ("", "metres", tuple(coordinates[at].tolist()), float(values[at]))
        if coordinates is not None and in_metres
        else ("", "entry", (float(at),), float(values[at]))
        for at in sorted(chosen)
    ]
