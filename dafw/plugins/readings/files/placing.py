"""Where the readings of a table are in a state: entries and weights, and which readings have no place in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dafw.core.domain import Domain
from dafw.core.errors import ConfigurationError
from dafw.core.geography import to_metres
from dafw.core.interpolation import weights_at
from dafw.core.space import Array, IntArray, StateSpace, Variable
from dafw.plugins.observers.path import line_means
from dafw.plugins.readings.files.table import Table


@dataclass(frozen=True, eq=False)
class Placed:
    """Reading r is the sum over k of weights[r, k] state[indices[r, k]]; both (R, k).

    ``coordinates`` (R, 2) are places in metres, None if readings have none. ``outside`` and ``in_building`` (R,) mark
    readings that cannot be used.
    """

    indices: IntArray
    weights: Array
    coordinates: Array | None
    outside: NDArray[np.bool_]
    in_building: NDArray[np.bool_]


def require_origin(origin: Sequence[float] | str | None, label: str) -> None:
    """Raise ConfigurationError, which begins with ``label``, for an option ``origin`` that says no place."""
    if origin is None or origin == "first":
        return
    if isinstance(origin, str) or len(origin) != 2 or abs(origin[0]) > 180.0 or abs(origin[1]) >= 90.0:
        raise ConfigurationError(f"{label}: origin must be [longitude, latitude] in degrees, or first, got {origin}")


def plane_origin(table: Table, origin: Sequence[float] | str | None) -> tuple[float, float] | None:
    """Return the longitude and latitude of the plane's (0, 0) that an option ``origin`` says; None: the site's.

    ``first`` is the place of the earliest row; of rows of the same time, that of the first. Raises ReadingsError if no
    row has a time, a longitude and a latitude.
    """
    if origin is None:
        return None
    if not isinstance(origin, str):
        return float(origin[0]), float(origin[1])
    lon, lat, time = (table.number(role) for role in ("lon", "lat", "time"))
    there = np.flatnonzero(np.isfinite(lon) & np.isfinite(lat) & np.isfinite(time))
    if not there.size:
        raise table.error("origin=first needs a reading with a time, a longitude and a latitude, and there is none")
    row = there[np.argmin(time[there])]
    return float(lon[row]), float(lat[row])


def in_plane(table: Table, origin: tuple[float, float] | None) -> Array:
    """Return the places (R, 2) in m: of longitudes and latitudes about an origin; None: the columns x and y."""
    if origin is None:
        return np.stack([table.number("x"), table.number("y")], axis=1)
    return to_metres(np.stack([table.number("lon"), table.number("lat")], axis=1), origin)


def placed(
    table: Table,
    kind: str | None,
    space: StateSpace,
    domain: Domain | None,
    name: str | None,
    origin: tuple[float, float] | None,
) -> Placed:
    """Return where the readings are in the variable ``name`` (None: the first).

    ``kind`` of PLACES says which columns count. ``origin`` is the longitude and latitude of (0, 0); None: the domain's.
    Raises ReadingsError if the table's places are not ones that the variable has.
    """
    variable = space.variables[0] if name is None else space[name]
    none = np.zeros(len(table), dtype=np.bool_)
    start = space.slice(variable.name).start
    if kind in (None, "entry"):
        indices, weights = _entries(table, kind, variable)
        return Placed(indices + start, weights, None, none, none)
    about = origin if origin is not None or domain is None else domain.origin
    if kind == "degrees" and about is None:
        raise table.error(
            "its places are longitudes and latitudes, and the model's plane has no place on Earth: expected the "
            "option origin, [longitude, latitude] of (0, 0), or first"
        )
    points = in_plane(table, about if kind == "degrees" else None)
    outside, in_building = none, none
    if domain is not None:
        outside = ~domain.are_inside(points)
        in_building = domain.are_in_obstacles(points) & ~outside
    triangles = domain.triangles if domain is not None and variable is space.variables[0] else None
    indices, weights = np.zeros((len(table), 3), dtype=np.int64), np.zeros((len(table), 3))
    if len(table):
        found, shares = weights_at(variable, triangles, points)
        indices[:, : found.shape[1]], weights[:, : shares.shape[1]] = found, shares
        _exactly_at_nodes(variable, points, indices, weights)
    return Placed(indices + start, weights, points, outside, in_building)


def placed_on_paths(
    table: Table, space: StateSpace, name: str | None, paths: Mapping[str, Array], label: str
) -> Placed:
    """Return where readings are that are means along lines, ``paths`` (2, 2) by sensor.

    Raises ReadingsError for a sensor without a path, ConfigurationError, which begins with ``label``, for a line that
    leaves the mesh.
    """
    variable = space.variables[0] if name is None else space[name]
    if variable.coordinates is None or variable.coordinates.shape[1] != 2:
        raise table.error(f"paths need a variable with places in the plane, '{variable.name}' has none: use entries")
    rows = _numbered(table, list(paths), "paths")
    indices, weights = line_means(variable, list(paths.values()), label)
    middles = np.array([ends.mean(axis=0) for ends in paths.values()])
    none = np.zeros(len(table), dtype=np.bool_)
    return Placed(indices[rows] + space.slice(variable.name).start, weights[rows], middles[rows], none, none)


def entries_of_sensors(table: Table, entries: Mapping[str, int]) -> Array:
    """Return the entry (R,) of every row's sensor; raises ReadingsError for a sensor that has none."""
    return np.array(list(entries.values()), dtype=np.float64)[_numbered(table, list(entries), "entries")]


def _numbered(table: Table, names: Sequence[str], option: str) -> IntArray:
    """Return the place (R,) of every row's sensor in a list; raises ReadingsError for one that is not in it."""
    number = {name: place for place, name in enumerate(names)}
    for row, sensor in enumerate(table.text("sensor")):
        if sensor not in number:
            raise table.error(f"the sensor '{sensor}' is not among {option}: {', '.join(names)}", row)
    return np.array([number[sensor] for sensor in table.text("sensor")], dtype=np.int64)


def _entries(table: Table, kind: str | None, variable: Variable) -> tuple[IntArray, Array]:
    if kind is None and variable.size > 1:
        raise table.error(
            f"has no places: expected columns x and y, lon and lat, or entry, because the variable '{variable.name}' "
            f"has {variable.size} numbers"
        )
    entry = np.zeros(len(table)) if kind is None else table.number("entry")
    if (entry >= variable.size).any():
        row = int(np.argmax(entry >= variable.size))
        raise table.error(
            f"expected an entry below {variable.size}, the size of the variable '{variable.name}', got {entry[row]:g}",
            row,
            "entry",
        )
    indices, weights = np.zeros((len(table), 3), dtype=np.int64), np.zeros((len(table), 3))
    indices[:, 0], weights[:, 0] = entry.astype(np.int64), 1.0
    return indices, weights


def _exactly_at_nodes(variable: Variable, points: Array, indices: IntArray, weights: Array) -> None:
    """Give a reading at a node the weight 1 of this node, without rounding: a twin's file then gives the same bits."""
    nearest = variable.nearest(points)
    same = (np.asarray(variable.coordinates)[nearest] == points).all(axis=1)
    indices[same], weights[same] = nearest[same, np.newaxis], [1.0, 0.0, 0.0]
