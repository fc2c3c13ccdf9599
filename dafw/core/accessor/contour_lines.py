"""Contours of a field at chosen times, as shapely geometries in metres and as GeoJSON in degrees."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from xarray import DataArray, Dataset

from dafw.core.accessor.contents import field_of, mesh_of
from dafw.core.errors import RunError
from dafw.core.files import write_atomically
from dafw.core.forecasts.contours import (
    Regions,
    collection,
    contour_of,
    feature,
    in_degrees,
    joined,
    lines_in_degrees,
)
from dafw.core.space import Array, IntArray


class Contour(NamedTuple):
    """Where a field equals a level (lines) or is above it (areas) at a time in seconds; in metres."""

    time: float
    level: float
    geometry: Any


def contours(
    run: Dataset,
    field: str | DataArray,
    levels: float | Sequence[float],
    time: float | Sequence[float] | None,
    *,
    filled: bool,
) -> list[Contour]:
    """Return the contours of a field by time and level: see ``RunAccessor.contours``."""
    values = field_of(run, field)
    nodes, triangles = mesh_of(run, values)
    regions = Regions(nodes, triangles) if filled else None
    wanted = _numbers("levels", levels)
    found = []
    for moment, row in _rows(values, time, np.unique(triangles)):
        for level in wanted:
            geometry = regions.above(row, level) if regions else joined(contour_of(nodes, triangles, row, level))
            found.append(Contour(moment, level, geometry))
    return found


def to_geojson(
    run: Dataset,
    path: Path,
    field: str | DataArray,
    levels: float | Sequence[float],
    time: float | Sequence[float] | None,
    *,
    filled: bool,
) -> Path:
    """Write the contours of a field as GeoJSON: see ``RunAccessor.to_geojson``."""
    if "origin_longitude" not in run.attrs or "origin_latitude" not in run.attrs:
        raise RunError("longitudes and latitudes need the place of the plane on Earth, which this run does not have")
    origin = (float(run.attrs["origin_longitude"]), float(run.attrs["origin_latitude"]))
    values = field_of(run, field)
    told = {"variable": str(values.name or "field"), "units": str(values.attrs.get("units", "1"))}
    features = [
        feature(
            in_degrees(one.geometry, origin) if filled else lines_in_degrees(one.geometry, origin),
            {**told, "time": one.time, "level": one.level},
        )
        for one in contours(run, values, levels, time, filled=filled)
        if not one.geometry.is_empty
    ]
    write_atomically(path, collection(features))
    return path


def _rows(values: DataArray, time: float | Sequence[float] | None, used: IntArray) -> Iterator[tuple[float, Array]]:
    """Yield the time and the field (n,) of each wanted row; raises RunError if there is none.

    ``used`` are the nodes that belong to a triangle.
    """
    others = [str(dim) for dim in values.dims if dim not in ("time", "node")]
    if others:
        raise RunError(f"contours need one field at a time: choose along {', '.join(others)} first")
    if "time" not in values.dims:
        moment = float(values.coords["time"]) if "time" in values.coords else float("nan")
        yield moment, _recorded(values, moment, used)
        return
    if "time" not in values.coords:
        raise RunError("the runs of this sweep have different times: choose one run first")
    times = values["time"].values.astype(np.float64)
    step = float(np.diff(times).max()) if len(times) > 1 else 0.0
    for wanted in [float(times[-1])] if time is None else _numbers("time", time):
        row = int(np.argmin(np.abs(times - wanted)))
        if abs(times[row] - wanted) > 0.5 * step + 1e-9:
            raise RunError(f"the run has no time near {wanted:g} s: it is from {times[0]:g} to {times[-1]:g} s")
        yield float(times[row]), _recorded(values.isel(time=row), float(times[row]), used)


def _recorded(row: DataArray, moment: float, used: IntArray) -> Array:
    field = row.values.astype(np.float64)
    if np.isnan(field[used]).any():
        raise RunError(
            f"'{row.name}' was not recorded at {moment:g} s: run the study with record.fields=all, or choose the "
            f"first or the last time"
        )
    return field


def _numbers(name: str, numbers: float | Sequence[float]) -> list[float]:
    found = np.atleast_1d(np.asarray(numbers, dtype=np.float64))
    if found.ndim != 1 or not np.isfinite(found).all():
        raise RunError(f"{name} must be a finite number or several, got {numbers}")
    return [float(one) for one in found]
