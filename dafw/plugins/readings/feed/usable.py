"""From the readings of a cycle to observations: errors, units and places as those of a file of readings have."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dafw.core.domain import Domain
from dafw.core.geography import to_metres
from dafw.core.observation import Interpolation, Observation
from dafw.core.space import Array, IntArray, StateSpace
from dafw.plugins.readings.feed.desk import Rules
from dafw.plugins.readings.feed.state import FeedState, Reading
from dafw.plugins.readings.files.placing import Placed, placed, placed_on_paths
from dafw.plugins.readings.files.screening import converted
from dafw.plugins.readings.files.sensors import ErrorOptions, censored, with_errors
from dafw.plugins.readings.files.table import PLACES, Table


def observations_of(
    readings: Sequence[Reading],
    rules: Rules,
    space: StateSpace,
    domain: Domain | None,
    end: float,
    *,
    variable: str | None = None,
    origin: tuple[float, float] | None = None,
    paths: Mapping[str, Array] | None = None,
) -> tuple[list[Observation], dict[str, int]]:
    """Return an observation for each time and kind of place, in the order of time, and how many had no place here.

    ``end`` (s) is that of the cycle; a time that is later by rounding becomes it. ``origin`` is that of the plane,
    where it has one. ``paths`` are lines (2, 2) by sensor that are read instead of places.
    """
    found: list[Observation] = []
    counts = {"outside": 0, "in_building": 0}
    for kind, table in _tables(
        [one for one in readings if one.value is not None], origin, placeless=paths is not None or rules.size == 1
    ):
        table, _ = censored(with_errors(table, _Errors(rules)), _Errors(rules))
        named = space.variables[0] if variable is None else space[variable]
        values, sd, limits = converted(table, rules.wanted)
        if paths is not None:
            at = placed_on_paths(table, space, variable, dict(paths), "readings 'live'")
        else:
            at = placed(table, kind or None, space, domain, named.name, origin)
        counts["outside"] += int(at.outside.sum())
        counts["in_building"] += int(at.in_building.sum())
        times = np.minimum(table.number("time"), end)
        free = ~(at.outside | at.in_building)
        for time in np.unique(times[free]).tolist():
            rows = np.flatnonzero(free & (times == time))
            found.append(Observation(values[rows], _operator(at, table, rows, sd[rows] ** 2, limits[rows]), time))
    found.sort(key=lambda one: one.time)
    return found, {reason: count for reason, count in counts.items() if count}


class _Errors(Mapping[str, ErrorOptions]):
    """The errors of any sensor."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules

    def __getitem__(self, name: str) -> ErrorOptions:
        return self.rules.errors.get(name, self.rules.common)

    def __iter__(self) -> Iterator[str]:
        return iter(self.rules.errors)

    def __len__(self) -> int:
        return len(self.rules.errors)


def _operator(at: Placed, table: Table, rows: IntArray, variances: Array, limits: Array) -> Interpolation:
    names, spans = tuple(table.text("sensor")[rows]), table.number("span")
    return Interpolation(
        indices=at.indices[rows],
        weights=at.weights[rows],
        covariance=variances,
        coordinates=None if at.coordinates is None else at.coordinates[rows],
        sensors=names if any(names) else None,
        limits=None if np.isnan(limits).all() else limits,
        spans=spans[rows] if spans.any() else None,
    )


def _tables(
    readings: Sequence[Reading], origin: tuple[float, float] | None, *, placeless: bool
) -> Iterator[tuple[str, Table]]:
    """Yield the readings by the kind of their place; degrees become metres first."""
    if placeless:
        by_kind = {"": list(readings)}
    else:
        by_kind = {}
        for reading in readings:
            one = in_metres(reading, origin)
            by_kind.setdefault(one.kind, []).append(one)
    for kind, rows in by_kind.items():
        if not rows:
            continue
        numbers = {
            "time": np.array([one.time for one in rows]),
            "value": np.array([one.value for one in rows], dtype=np.float64),
            "sd": np.array([np.nan if one.sd is None else one.sd for one in rows]),
            "span": np.array([one.span for one in rows]),
        }
        if kind:
            columns = np.array([one.place for one in rows]).T
            numbers |= dict(zip(PLACES[kind], columns, strict=True))
        texts = {role: np.array([getattr(one, role) for one in rows], dtype=object) for role in ("unit", "sensor")}
        yield kind, Table("the feed", "message", np.arange(len(rows)), numbers, texts)


def in_metres(reading: Reading, origin: tuple[float, float] | None) -> Reading:
    """Return a reading whose place is in metres if it was in degrees."""
    if reading.kind != "degrees" or origin is None:
        return reading
    x, y = to_metres(np.array(reading.place), origin).tolist()
    return replace(reading, kind="metres", place=(x, y))


def vehicles_of(
    readings: Sequence[Reading],
    rules: Rules,
    state: FeedState,
    domain: Domain | None,
    origin: tuple[float, float] | None,
) -> tuple[dict[int, Array], int]:
    """Return by number where the readings say that vehicles are, (2,) in metres, and how many places cannot be.

    The latest time counts; of several messages of the same time, the last. Where messages tell nothing but the place of
    a vehicle, those with its readings do not count: a reading may be of a place beside it. A vehicle cannot be outside
    the domain or in a building. ``state`` is changed.
    """
    impossible = 0
    tell = {rules.vehicle(reading.sensor) for reading in readings if reading.value is None}
    for reading in readings:
        number = rules.vehicle(reading.sensor)
        one = in_metres(reading, origin)
        if number is None or one.kind != "metres" or (reading.value is not None and number in tell):
            continue
        if number in state.vehicles and one.time < state.vehicles[number][0]:
            continue
        place = np.array(one.place)
        if domain is not None and not domain.is_free(place, place):
            impossible += reading.value is None  # readings in buildings are counted as such
            continue
        x, y = one.place
        state.vehicles[number] = (one.time, x, y)
    return {number: np.array(seen[1:]) for number, seen in state.vehicles.items()}, impossible
