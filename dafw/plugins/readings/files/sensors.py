"""What sensors do to readings: background, noise, means, readings at one time, a slow response, a detection limit.

A slow sensor of the first order with the response time T shows z where it meets c:

    dz/dt = (c - z) / T

From two of its readings, a time s apart, follows what it met between them, taken as constant:

    c = (z_2 - a z_1) / (1 - a)        a = exp(-s / T)        sd(c) = sqrt(sd_2^2 + a^2 sd_1^2) / (1 - a)

The errors of neighbouring c are anticorrelated, which is left out: R stays diagonal.

Of a reading below the detection limit L it is only known that the value lies between 0 and L. ``below_limit`` says what
stands for it; filters with a likelihood take it for what it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from dafw.core.observation import below_limit
from dafw.core.options import build, option
from dafw.core.space import Array
from dafw.plugins.readings.files.table import Table

REPEATED = ("keep", "first", "mean")


@dataclass
class ErrorOptions:
    """The errors of a sensor, in the unit of the file; of all sensors, where they have no options of their own."""

    sd: float | None = option(
        None, "standard deviation of the error of readings for which the file has none", above=0.0
    )
    relative_sd: float = option(0.0, "another part of the error, as a share of the value less background", minimum=0.0)
    background: float = option(0.0, "subtracted from every value, in the unit of the file")
    detection_limit: float | None = option(
        None, "of a value (less background) below it is only known that it lies between 0 and this", above=0.0
    )


@dataclass
class SensorOptions(ErrorOptions):
    """The errors of a sensor that may follow slowly, and over how long its readings are averaged."""

    response_time: float = option(0.0, "time constant with which the sensor follows what it meets, s", minimum=0.0)
    averaging: float | None = option(
        None, "a sensor's readings become their means over this many seconds from t = 0; null: as they are", above=0.0
    )


def sensors_of(table: Table, common: SensorOptions, own: Mapping[str, Any], where: str) -> dict[str, SensorOptions]:
    """Return the options of every sensor of a table; raises ReadingsError for options of a sensor that is not in it."""
    names = list(dict.fromkeys(table.text("sensor")))
    for name in own:
        if name not in names:
            raise table.error(f"no sensor '{name}' (there are: {', '.join(names) or 'none'})")
    shared = {one.name: getattr(common, one.name) for one in fields(SensorOptions)}
    return {name: build(SensorOptions, shared | dict(own.get(name, {})), f"{where}, sensor '{name}'") for name in names}


def with_errors(table: Table, sensors: Mapping[str, ErrorOptions]) -> Table:
    """Return the table with values less background, and ``sd`` in every row; raises ReadingsError if one has none."""
    background = _of_rows(table, lambda name: sensors[name].background)
    value = table.number("value") - background if background.any() else table.number("value")
    sd = table.number("sd")
    sd = np.where(np.isnan(sd), _of_rows(table, lambda name: sensors[name].sd or np.nan), sd)
    if np.isnan(sd).any():
        row = int(np.argmax(np.isnan(sd)))
        raise table.error("has no standard deviation: expected a column 'sd' or the option sd", row)
    share = _of_rows(table, lambda name: sensors[name].relative_sd)
    return table.changed(value=value, sd=np.hypot(sd, share * np.abs(value)) if share.any() else sd)


def without_repeats(table: Table, repeated: str) -> tuple[Table, int]:
    """Return the table, sorted by time, with one reading of a sensor at a time, and how many there were beside it.

    ``repeated`` says what becomes of the others: ``keep`` them all, keep the ``first``, or take the ``mean`` of them,
    which is known when the last of them has arrived.
    """
    groups: dict[tuple[str, float], list[int]] = {}
    for row, key in enumerate(zip(table.text("sensor"), table.number("time").tolist(), strict=True)):
        groups.setdefault(key, []).append(row)
    more = len(table) - len(groups)
    if repeated == "keep" or not more:
        return table, more
    firsts = np.array([rows[0] for rows in groups.values()])
    kept = table.chosen(firsts)
    if repeated == "first":
        return kept, more
    means = {role: column.copy() for role, column in kept.numbers.items() if role not in ("entry", "time")}
    known = _known(table)
    for place, rows in enumerate(groups.values()):
        if len(rows) > 1:
            for role, column in means.items():
                part = table.numbers[role][rows]
                column[place] = np.sqrt(np.sum(part**2)) / len(rows) if role == "sd" else part.mean()
            if "arrives" in means:
                means["arrives"][place] = known[rows].max()
    return kept.changed(**means), more


def averaged(table: Table, sensors: Mapping[str, SensorOptions]) -> Table:
    """Return the table, sorted by time, with means over spans of the sensor's ``averaging`` seconds from t = 0.

    A mean has the time of its span's end. It is known then, or later when the last of its readings has arrived. The
    errors of single readings are taken to be independent. Places, where there are any, are averaged too. Readings of
    sensors without ``averaging`` stay as they are.
    """
    span = _of_rows(table, lambda name: sensors[name].averaging or np.nan)
    spanned = ~np.isnan(span)
    if not spanned.any():
        return table
    number = np.where(spanned, np.ceil(table.number("time") / span - 1e-9), np.arange(len(table)))
    names = {name: place for place, name in enumerate(dict.fromkeys(table.text("sensor")))}
    sensor = np.array([names[name] for name in table.text("sensor")])
    _, first, group = np.unique(np.stack([number, sensor]), axis=1, return_index=True, return_inverse=True)
    count = np.bincount(group.ravel())
    means: dict[str, Array] = {}
    for role, column in table.numbers.items():
        if role == "sd":
            means[role] = np.sqrt(np.bincount(group.ravel(), column**2)) / count
        elif role != "entry":
            means[role] = np.bincount(group.ravel(), column) / count
    means["time"] = number[first] * span[first]
    if "arrives" in means:
        means["arrives"] = means["time"].copy()
        np.fmax.at(means["arrives"], group.ravel(), _known(table))
    kept, alone = table.chosen(first), ~spanned[first]
    columns = {role: np.where(alone, kept.number(role), column) for role, column in means.items()}
    averages = kept.changed(**columns)
    averages = averages.changed(span=np.where(alone, kept.number("span"), span[first]))
    return averages.chosen(np.argsort(averages.number("time"), kind="stable"))


def undone_response(table: Table, sensors: Mapping[str, SensorOptions]) -> tuple[Table, int]:
    """Return the table, sorted by time, with what slow sensors met instead of what they showed.

    The first reading of a slow sensor only says where it starts, and is left out; the second number is how many these
    are. Raises ReadingsError if a slow sensor has two readings at the same time.
    """
    value, sd, kept = table.number("value").copy(), table.number("sd").copy(), np.ones(len(table), dtype=bool)
    names, time, known = table.text("sensor"), table.number("time"), _known(table)
    arrives = known.copy()
    for name, options in sensors.items():
        if options.response_time == 0.0:
            continue
        rows = np.flatnonzero(names == name)
        spans = np.diff(time[rows])
        if (spans <= 0.0).any():
            raise table.error(
                "a sensor with a response time has two readings at this time: expected repeated=first or mean",
                int(rows[1:][spans <= 0.0][0]),
            )
        a = np.exp(-spans / options.response_time)
        before, after = rows[:-1], rows[1:]
        shown, spread = table.number("value"), table.number("sd")
        value[after] = (shown[after] - a * shown[before]) / (1.0 - a)
        sd[after] = np.hypot(spread[after], a * spread[before]) / (1.0 - a)
        arrives[after] = np.maximum(known[before], known[after])  # it takes both
        kept[rows[:1]] = False
    times = {"arrives": arrives} if "arrives" in table.numbers else {}
    return table.changed(value=value, sd=sd, **times).chosen(kept), int((~kept).sum())


def censored(table: Table, sensors: Mapping[str, ErrorOptions]) -> tuple[Table, int]:
    """Return the table with readings below the detection limit replaced, and how many these are.

    Their limits are in a column ``limit``, in the unit of the file, which is NaN for all others.
    """
    limit = _of_rows(table, lambda name: sensors[name].detection_limit or -np.inf)
    below = table.number("value") < limit
    if not below.any():
        return table, 0
    value, sd = table.number("value").copy(), table.number("sd").copy()
    value[below], variance = below_limit(limit[below], sd[below] ** 2)
    sd[below] = np.sqrt(variance)
    return table.changed(value=value, sd=sd, limit=np.where(below, limit, np.nan)), int(below.sum())


def _known(table: Table) -> Array:
    """Return when every row is known (R,), in s: when it arrives; where that is not told, at its time."""
    return np.fmax(table.number("time"), table.number("arrives"))


def _of_rows(table: Table, of: Callable[[str], float]) -> Array:
    """Return a number of every row's sensor (R,)."""
    known = {name: of(name) for name in set(table.text("sensor"))}
    return np.array([known[name] for name in table.text("sensor")], dtype=np.float64)
