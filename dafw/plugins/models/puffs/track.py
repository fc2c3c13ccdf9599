"""Where a moving sensor was: places and heights over time, from the columns of a file of readings.

Between its rows the sensor moves along straight lines; before the first row and after the last it stays where it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dafw.core.errors import ConfigurationError
from dafw.core.options import option
from dafw.core.space import Array
from dafw.plugins.readings.files.options import FileOptions
from dafw.plugins.readings.files.placing import in_plane, plane_origin, require_origin


@dataclass
class TrackFile(FileOptions):
    """Where the sensor was. ``columns.value`` is not used."""

    file: str = option("", "path of the file with times and places; empty: listed points")
    points: list[list[float]] = option([], "without a file: rows [t, x, y, z] in s and m")
    height: str = option("z", "column of the height above the ground, m; below 0 it is taken as 0")
    origin: list[float] | str | None = option(None, "as for readings=recorded: the same place")
    start: float | str | None = option(None, "what is t = 0, as for readings=recorded: the same time")


@dataclass(frozen=True, eq=False)
class Track:
    """Times (S,) in s, ascending, and places (S, 3) in m: x, y and the height above the ground."""

    time: Array
    places: Array

    def at(self, t: Array) -> Array:
        """Return the places (k, 3) at times (k,)."""
        return np.stack([np.interp(t, self.time, self.places[:, axis]) for axis in range(3)], axis=1)


def of_rows(time: Array, places: Array) -> Track:
    """Return the track of rows in any order; places of the same time are averaged."""
    moments, group = np.unique(time, return_inverse=True)
    count = np.bincount(group, minlength=len(moments))
    means = [np.bincount(group, places[:, axis], len(moments)) / count for axis in range(3)]
    means[2] = np.maximum(means[2], 0.0)
    return Track(moments, np.stack(means, axis=1))


def read_track(options: TrackFile, label: str) -> Track:
    """Return the track that the options name; raises ReadingsError, and ConfigurationError that begins with ``label``.

    Rows without a time, a place or a height are left out.
    """
    require_origin(options.origin, f"{label}: track")
    if bool(options.file) == bool(options.points):
        raise ConfigurationError(f"{label}: track needs a file or points, and not both")
    if options.points:
        rows = _listed(options.points, label)
        return of_rows(rows[:, 0], rows[:, 1:])
    from dafw.plugins.readings.files.any_file import read_table
    from dafw.plugins.readings.files.screening import start_of

    columns = replace(options.columns, value=options.height, unit=None, sd=None)
    table = read_table(replace(options, columns=columns))
    kind = table.place_kind(options.place)
    if kind == "degrees":
        origin = plane_origin(table, options.origin)
        if origin is None:
            raise table.error("its places are longitudes and latitudes: expected the option origin, or origin=first")
        flat = in_plane(table, origin)
    elif kind == "metres":
        flat = in_plane(table, None)
    else:
        raise table.error("a track needs columns x and y, or lon and lat")
    time = table.number("time") - start_of(table, options.start)
    rows = np.column_stack([time, flat, table.number("value")])
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows):
        raise table.error("no row has a time, a place and a height")
    return of_rows(rows[:, 0], rows[:, 1:])


def _listed(points: Sequence[Sequence[float]], label: str) -> Array:
    """Return listed rows (S, 4); raises ConfigurationError."""
    if any(len(row) != 4 for row in points):
        raise ConfigurationError(f"{label}: track.points must be rows [t, x, y, z], got {list(points)}")
    return np.array(points, dtype=np.float64)
