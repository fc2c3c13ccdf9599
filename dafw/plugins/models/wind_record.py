"""A wind that somebody measured at one place: how far it carries something, and how much it fluctuates.

The wind is taken to be the same everywhere, as it nearly is on flat ground without buildings. Something that is carried
along moves from time a to time b by ::

    X(b) - X(a),    X(t) = integral of (u, v) from 0 to t

with the measured wind linear between its samples, so that gaps are bridged. Before the first sample the wind is the
mean of the first minute, after the last one that of the last. Spikes, more than ``SPIKE`` robust standard deviations
from the median of their 15 neighbours, are left out; a record of fewer samples has none. The turbulence at time t is
the standard deviation of the samples of the last ten minutes; during the first minute, that of the first minute.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dafw.core.errors import ConfigurationError
from dafw.core.options import option
from dafw.core.space import Array
from dafw.plugins.readings.files.options import ColumnOptions, FileOptions

if TYPE_CHECKING:
    from dafw.plugins.readings.files.table import Table

BLOWS = ("from", "to")
"""Whether a direction says where the wind comes from or where it goes to."""

SPIKE, FLOOR = 5.0, 0.3
"""Robust standard deviations, and m/s beside them, by which a spike leaves the median of its neighbours."""
NEIGHBOURS = 15
TURBULENCE = 600.0
"""Seconds over which the standard deviation of the wind is taken."""
MINUTE = 60.0
ALWAYS = 1e9
"""Seconds around t = 0 for which a steady wind is given."""
BEYOND = 1e5
"""Seconds for which the wind is extended before the first sample and after the last."""


@dataclass
class WindColumns(FileOptions):
    """Where a wind along the ground was recorded. ``columns.value`` is not used."""

    file: str = option("", "path of the file with the wind; a * in it names several files")
    x: str = option("wind_x", "column of the wind's component along x, m/s; with a minus before it, its negative")
    y: str = option("wind_y", "column of the component along y")
    speed: str | None = option(
        None, "column of the wind's speed, with that of its direction: instead of x and y; null: x and y are there"
    )
    direction: str | None = option(None, "column of the wind's direction, clockwise from north")
    blows: str = option("from", "whether the direction is that from which the wind blows, or to", choices=BLOWS)
    starts: list[str | None] = option(
        [],
        "for a clock that begins again with every flight: the dates at which it showed 0, null to leave a flight out",
    )
    start: float | str | None = option(
        None, "what is t = 0, as for readings=recorded: the same time; first: that of the first wind"
    )


@dataclass
class WindFile(WindColumns):
    """Where a wind and its upward component were recorded, or a steady wind."""

    file: str = option("", "path of the file with the wind; a * in it names several files; empty: a steady wind")
    steady: list[float] = option(
        [], "without a file: [x, y, s, h] in m/s, the wind's components and its standard deviations, sideways, upwards"
    )
    z: str = option("wind_z", "column of the component upwards")
    upward: float | None = option(
        None,
        "if no upward component was measured: the standard deviation of its fluctuations as a share of that of a "
        "horizontal one; null: column z is there",
        minimum=0.0,
    )


@dataclass(frozen=True, eq=False)
class WindRecord:
    """Samples ``wind`` (S, 3) in m/s at ``time`` (S,) in s, ascending; ``carried`` (S, 2) in m is X at these times.

    The first and the last are those that extend the record.

    ``turbulence`` (S, 2) are standard deviations, in m/s, of a horizontal and of the upward component. ``spikes`` is
    the number of samples that were left out.
    """

    time: Array
    wind: Array
    carried: Array
    turbulence: Array
    spikes: int

    def carried_by(self, t: Array) -> Array:
        """Return X (..., 2) in m at times (...)."""
        return np.stack([np.interp(t, self.time, self.carried[:, axis]) for axis in range(2)], axis=-1)

    def turbulence_at(self, t: Array) -> Array:
        """Return the standard deviations (..., 2) in m/s at times (...)."""
        before = np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, None)
        return np.asarray(self.turbulence[before])


def of_samples(time: Array, wind: Array, upward: float | None = None) -> WindRecord:
    """Return the record of samples: times (S,) in s, wind (S, 3) in m/s.

    ``upward`` is the standard deviation of the upward component as a share of that of a horizontal one, where it was
    not measured. Raises ConfigurationError if they are of less than two times.
    """
    order = np.argsort(time, kind="stable")
    time, wind = time[order], wind[order]
    kept = ~are_spikes(wind)
    moments, group = np.unique(time[kept], return_inverse=True)
    if len(moments) < 2:
        raise ConfigurationError(f"a measured wind needs samples at two times or more, got {len(moments)}")
    count = np.bincount(group)
    means = np.stack([np.bincount(group, wind[kept, axis]) / count for axis in range(3)], axis=1)
    early = means[moments <= moments[0] + MINUTE].mean(axis=0)
    late = means[moments >= moments[-1] - MINUTE].mean(axis=0)
    steps = 0.5 * (means[1:, :2] + means[:-1, :2]) * np.diff(moments)[:, np.newaxis]
    steps = np.vstack([early[:2] * BEYOND, steps, late[:2] * BEYOND])
    turbulence = _turbulence(moments, means)
    if upward is not None:
        turbulence[:, 1] = upward * turbulence[:, 0]
    return WindRecord(
        time=np.hstack([moments[0] - BEYOND, moments, moments[-1] + BEYOND]),
        wind=np.vstack([early, means, late]),
        carried=np.vstack([np.zeros(2), np.cumsum(steps, axis=0)]),
        turbulence=np.vstack([turbulence[:1], turbulence, turbulence[-1:]]),
        spikes=int((~kept).sum()),
    )


def steady_wind(numbers: Sequence[float]) -> WindRecord:
    """Return the record of a wind that never changes: x, y and its standard deviations; raises ConfigurationError."""
    if len(numbers) != 4 or min(numbers[2:]) < 0.0:
        raise ConfigurationError(f"wind.steady must be [x, y, s, h] in m/s, got {list(numbers)}")
    time, wind = np.array([-ALWAYS, ALWAYS]), np.tile([*numbers[:2], 0.0], (2, 1))
    return WindRecord(time, wind, time[:, np.newaxis] * wind[:, :2], np.tile(numbers[2:], (2, 1)), 0)


def are_spikes(wind: Array) -> NDArray[np.bool_]:
    """Return which samples (S,) of a wind (S, 3) in the order of time are far from the median of their neighbours."""
    from scipy.ndimage import median_filter

    if len(wind) < NEIGHBOURS:
        return np.zeros(len(wind), dtype=np.bool_)
    off = np.abs(wind - median_filter(wind, (NEIGHBOURS, 1), mode="reflect"))
    usual = 1.4826 * median_filter(off, (10 * NEIGHBOURS + 1, 1), mode="reflect")
    return np.asarray((off > SPIKE * usual + FLOOR).any(axis=1))


def _turbulence(time: Array, wind: Array) -> Array:
    """Return standard deviations (S, 2) of the last ten minutes: of a horizontal component, and upwards."""
    sums = np.vstack([np.zeros(6), np.cumsum(np.hstack([wind, wind**2]), axis=0)])
    last = np.maximum(np.arange(len(time)) + 1, np.searchsorted(time, time[0] + MINUTE, side="right"))
    first = np.searchsorted(time, time - TURBULENCE)
    count = np.maximum(last - first, 1)[:, np.newaxis]
    mean, square = np.split((sums[last] - sums[first]) / count, 2, axis=1)
    variance = np.maximum(square - mean**2, 0.0)
    return np.sqrt(np.stack([0.5 * (variance[:, 0] + variance[:, 1]), variance[:, 2]], axis=1))


def read_wind(options: WindFile) -> WindRecord:
    """Return the wind of the files that the options name, or the steady one; raises ReadingsError.

    Raises ConfigurationError if neither or both are given.
    """
    if bool(options.file) == bool(options.steady):
        raise ConfigurationError("wind needs a file with a measured wind, or steady, and not both")
    if options.steady:
        return steady_wind(options.steady)
    time, flat = _along_the_ground(options, "wind")
    up = np.zeros(len(time)) if options.upward is not None else _component(options, options.z)
    return _of_rows(time, np.column_stack([flat, up]), options.upward)


def read_wind_along_the_ground(options: WindColumns, group: str) -> WindRecord:
    """Return the wind of the files that the options of a ``group`` name, without an upward component.

    Raises ReadingsError, and ConfigurationError for options that do not fit together.
    """
    time, flat = _along_the_ground(options, group)
    return _of_rows(time, np.column_stack([flat, np.zeros(len(time))]), 0.0)


def _of_rows(time: Array, wind: Array, upward: float | None) -> WindRecord:
    """Return the record of the rows of a file that have a time (S,) and a wind (S, 3)."""
    there = np.isfinite(time) & np.isfinite(wind).all(axis=1)
    return of_samples(time[there], wind[there], upward)


def _along_the_ground(options: WindColumns, group: str) -> tuple[Array, Array]:
    """Return times (S,) in s since t = 0 and the wind's components (S, 2) in m/s along x and y."""
    if (options.speed is None) != (options.direction is None):
        raise ConfigurationError(f"{group}.speed and {group}.direction belong together, and one is missing")
    from dafw.plugins.models.wind_words import components_of, on_the_clock
    from dafw.plugins.readings.files.screening import start_of

    for option_name, name in (("speed", options.speed), ("direction", options.direction)):
        if name is not None and name.startswith("-"):
            raise ConfigurationError(f"{group}.{option_name}: a minus stands before a component only, got '{name}'")
    if options.speed is not None and options.direction is not None:
        table = _table(options, options.speed)
        flat = components_of(_table(options, options.direction), table, options.blows)
    else:
        table = _table(options, options.x)
        flat = np.stack([_component(options, options.x), _component(options, options.y)], axis=1)
    if options.starts:
        return on_the_clock(table, options.starts, options.start, group), flat
    time = table.number("time")
    if options.start == "first":
        there = time[np.isfinite(time) & np.isfinite(flat).all(axis=1)]
        return time - (there.min() if there.size else 0.0), flat
    return time - start_of(table, options.start), flat


def _table(options: WindColumns, name: str) -> Table:
    """Return the table of the times and of one column."""
    from dafw.plugins.readings.files.any_file import read_table

    columns = ColumnOptions(time=options.columns.time, value=name.removeprefix("-"))
    return read_table(replace(options, columns=columns))


def _component(options: WindColumns, name: str) -> Array:
    """Return a column of speeds (S,) in m/s; with a minus before its name, their negatives."""
    from dafw.plugins.readings.files.screening import converted

    return np.asarray(converted(_table(options, name), "m/s")[0] * (-1.0 if name.startswith("-") else 1.0))
