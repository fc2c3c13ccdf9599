"""Readings in GeoJSON (RFC 7946): one point for each reading, everything else in its properties."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dafw.core.geography import to_degrees
from dafw.plugins.readings.files.cells import Raw, find_columns, made, without_unit
from dafw.plugins.readings.files.options import FileOptions
from dafw.plugins.readings.files.table import NUMBERS, TEXTS, Table, about, shown, written_date

GEOMETRY = "coordinates of the point"


def read_geojson(path: Path, options: FileOptions) -> Table:
    """Return the readings of a file; raises ReadingsError, which names the feature and the property.

    Longitude and latitude are those of the point, unless properties of these names say others. Where properties x and
    y give the place in metres, points are not read.
    """
    name = str(path)
    features = _features(_parsed(path, name), name)
    places, properties = [], []
    for number, feature in enumerate(features, 1):
        if not isinstance(feature, dict) or feature.get("type") != "Feature":
            raise about(name, f"expected an object of the type Feature, got {shown(feature)}", "feature", number)
        given = feature.get("properties")
        if not isinstance(given, dict):
            raise about(name, f"expected properties with time and value, got {shown(given)}", "feature", number)
        places.append(_point(feature.get("geometry"), name, number))
        properties.append(given)
    headers = list(dict.fromkeys(key for given in properties for key in given))
    if not features:  # a file without readings is one with all columns
        headers = ["time", "value"]
    found = find_columns(headers, options.columns, name)
    cells: dict[str, Sequence[Any]] = {
        role: [given.get(headers[place]) for given in properties] for role, place in found.items()
    }
    names = {role: headers[place] for role, place in found.items()}
    in_metres = {"x", "y"} <= set(found) and options.place in ("auto", "metres")  # the points are for maps only
    if any(place is not None for place in places) and not {"lon", "lat"} & set(found) and not in_metres:
        for axis, role in enumerate(("lon", "lat")):
            cells[role] = [None if place is None else place[axis] for place in places]
            names[role] = GEOMETRY
    units = {role: unit for role, place in found.items() if (unit := without_unit(headers[place])[1])}
    others = tuple(header for number, header in enumerate(headers) if number not in found.values())
    return made(Raw(name, "feature", range(1, len(features) + 1), cells, names, units, others), options)


def _parsed(path: Path, name: str) -> Any:
    try:
        return json.loads(path.read_bytes().decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise about(name, "expected GeoJSON in UTF-8, got something that is not text") from None
    except json.JSONDecodeError as error:
        raise about(
            name, f"is not JSON, or cut off ({error.msg}, column {error.colno})", "line", error.lineno
        ) from None
    except RecursionError:
        raise about(name, "is nested too deeply for GeoJSON") from None
    except ValueError as error:  # a whole number with thousands of digits
        raise about(name, f"holds a number that cannot be read ({' '.join(str(error).split())[:60]})") from None


def _features(document: Any, name: str) -> list[Any]:
    kind = document.get("type") if isinstance(document, dict) else None
    if kind not in ("FeatureCollection", "Feature"):
        got = f"the type {shown(kind)}" if isinstance(document, dict) else f"a {type(document).__name__}"
        raise about(name, f"expected a GeoJSON FeatureCollection, got {got}")
    crs = document.get("crs")
    if crs is not None and "CRS84" not in json.dumps(crs).upper():
        raise about(name, f"expected longitude and latitude in the reference system CRS84, got {shown(crs)}")
    features = [document] if kind == "Feature" else document.get("features")
    if not isinstance(features, list):
        raise about(name, f"expected a list 'features', got {shown(features)}")
    return features


def _point(geometry: Any, name: str, number: int) -> tuple[Any, Any] | None:
    """Return longitude and latitude of a feature's point; None if it has none."""
    if geometry is None:
        return None
    if not isinstance(geometry, dict) or geometry.get("type") != "Point":
        got = geometry.get("type") if isinstance(geometry, dict) else geometry
        raise about(name, f"expected a Point, got {shown(got)}", "feature", number)
    place = geometry.get("coordinates")
    if not isinstance(place, list) or len(place) < 2:
        raise about(name, f"expected coordinates [longitude, latitude], got {shown(place)}", "feature", number)
    for value in place[:2]:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise about(name, f"expected coordinates in degrees, got {shown(place)}", "feature", number)
    return place[0], place[1]


def write_geojson(table: Table, path: Path, origin: tuple[float, float] | None = None) -> None:
    """Write a table; reading the file gives the same numbers, to the last bit.

    Places in metres stand in the properties. If the ``origin`` of the plane (longitude, latitude) is known, the points
    are at the same place in degrees, for maps; else there are no points.
    """
    points = _points(table, origin)
    features = []
    for row in range(len(table)):
        properties = {role: _written(table, role, row) for role in (*NUMBERS, *TEXTS) if _is_property(table, role)}
        geometry = None if points[row] is None else {"type": "Point", "coordinates": points[row]}
        features.append({"type": "Feature", "geometry": geometry, "properties": properties})
    lines = ",\n".join(json.dumps(feature, ensure_ascii=False, allow_nan=False) for feature in features)
    path.write_text(f'{{"type": "FeatureCollection", "features": [\n{lines}\n]}}\n', encoding="utf-8", newline="")


def _points(table: Table, origin: tuple[float, float] | None) -> list[list[float] | None]:
    lon, lat = table.number("lon"), table.number("lat")
    if "lon" not in table.numbers and origin is not None and "x" in table.numbers:
        lon, lat = to_degrees(np.stack([table.number("x"), table.number("y")], axis=1), origin).T
    places = zip(lon.tolist(), lat.tolist(), strict=True)
    return [[x, y] if abs(x) <= 360.0 and abs(y) <= 90.0 else None for x, y in places]


def _is_property(table: Table, role: str) -> bool:
    """Return whether a role is written as a property: longitude and latitude are those of the point."""
    return (role in table.numbers or role in table.texts) and role not in ("lon", "lat")


def _written(table: Table, role: str, row: int) -> Any:
    if role in TEXTS:
        return table.texts[role][row]
    value = float(table.numbers[role][row])
    if np.isnan(value):
        return None
    if role in ("time", "arrives") and table.epoch is not None:
        return written_date(table.epoch, value)
    return int(value) if role == "entry" else value
