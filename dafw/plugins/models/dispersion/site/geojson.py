"""Read building footprints from a GeoJSON file (RFC 7946)."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dafw.core.errors import SiteError

MAN_MADE = frozenset(
    {"bunker_silo", "chimney", "cooling", "cooling_tower", "flare", "gasometer", "kiln", "reservoir_covered"}
    | {"silo", "storage_tank", "tower", "water_tower"}
)
"""Values of the OpenStreetMap key ``man_made`` that count as buildings."""

NO_BUILDING = ("no", "", None, False)
"""Values of the key ``building`` that mean: not a building."""

GEOMETRIES = {"Point", "MultiPoint", "LineString", "MultiLineString", "Polygon", "MultiPolygon", "GeometryCollection"}


@dataclass(frozen=True)
class Outline:
    """One polygon of a building as in the file.

    Attributes:
        rings: the outer ring and then the holes, each (k, 2) of longitude and latitude in degrees.
        name: of the building.
        kind: of the building.
    """

    rings: list[np.ndarray]
    name: str
    kind: str


def read_outlines(path: Path, report: dict[str, int]) -> list[Outline]:
    """Read the polygons of all buildings.

    A feature is a building if ``building`` is set and not "no", or if ``man_made`` is one of ``MAN_MADE``. If no
    feature of the file has such a property, every polygon counts as a building.

    Args:
        path: the file.
        report: counts of what was ignored, which this adds to.

    Raises SiteError, which names the file and the feature.
    """
    features = _features(_parse(path), path)
    report["features"] = len(features)
    tagged = any(_is_tagged(properties) for _, properties in features)
    outlines = []
    for number, (geometry, properties) in enumerate(features, start=1):
        place = f"site file {path}, feature {number}"
        if tagged and not _is_building(properties):
            report["not_buildings"] += 1
            continue
        polygons = list(_polygons(geometry, place))
        if not polygons:
            report["without_polygon" if tagged else "not_buildings"] += 1
        report["untagged"] += 0 if tagged else len(polygons)
        for polygon in polygons:
            if not isinstance(polygon, list):
                raise SiteError(f"{place}: expected a polygon as a list of rings, got {_short(polygon)}")
            rings = [_ring(ring, place) for ring in polygon]
            outlines.append(Outline(rings, str(properties.get("name") or f"building {number}"), _kind(properties)))
    return outlines


def _parse(path: Path) -> Any:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise SiteError(f"site file {path}: not found") from None
    except OSError as error:
        raise SiteError(f"site file {path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise SiteError(f"site file {path}: expected GeoJSON in UTF-8, got something that is not text") from None
    if not text.strip():
        raise SiteError(f"site file {path}: is empty, expected GeoJSON")
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        where = f"{error.msg} at line {error.lineno}, column {error.colno}"
        raise SiteError(f"site file {path}: not JSON, or cut off ({where})") from None
    except RecursionError:
        raise SiteError(f"site file {path}: nested too deeply for GeoJSON") from None


def _features(document: Any, path: Path) -> list[tuple[Any, dict[str, Any]]]:
    """Return (geometry, properties) of every feature; a bare geometry is a feature without properties."""
    kind = document.get("type") if isinstance(document, dict) else None
    if not isinstance(kind, str) or kind not in {"FeatureCollection", "Feature"} | GEOMETRIES:
        got = f"type {kind!r}" if isinstance(document, dict) else type(document).__name__
        raise SiteError(f"site file {path}: expected a GeoJSON FeatureCollection, got {got}")
    _check_reference_system(document.get("crs"), path)
    if kind == "FeatureCollection":
        listed = document.get("features")
        if not isinstance(listed, list):
            raise SiteError(f"site file {path}: expected a list 'features', got {_short(listed)}")
    else:
        listed = [document if kind == "Feature" else {"geometry": document}]
    features = []
    for number, feature in enumerate(listed, start=1):
        if not isinstance(feature, dict):
            raise SiteError(f"site file {path}, feature {number}: expected an object, got {_short(feature)}")
        properties = feature.get("properties")
        features.append((feature.get("geometry"), properties if isinstance(properties, dict) else {}))
    return features


def _check_reference_system(crs: Any, path: Path) -> None:
    """Raise SiteError unless the file is in longitude and latitude on WGS84.

    RFC 7946 allows no other system; older files may name this one as CRS84.
    """
    if crs is None:
        return
    properties = crs.get("properties") if isinstance(crs, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    if not (isinstance(name, str) and name.upper().endswith("CRS84")):
        raise SiteError(f"site file {path}: expected lon/lat in the reference system CRS84, got {_short(name or crs)}")


def _is_tagged(properties: dict[str, Any]) -> bool:
    return properties.get("building") is not None or properties.get("man_made") in MAN_MADE


def _is_building(properties: dict[str, Any]) -> bool:
    return properties.get("building") not in NO_BUILDING or properties.get("man_made") in MAN_MADE


def _kind(properties: dict[str, Any]) -> str:
    """Return the value of ``man_made`` or ``building`` that names a kind; "yes" does not."""
    for key in ("man_made", "building"):
        value = properties.get(key)
        if isinstance(value, str) and value not in ("yes", "no", ""):
            return value
    return "building"


def _polygons(geometry: Any, place: str) -> Iterator[Any]:
    """Yield the coordinates of every polygon in a geometry, however it is nested."""
    if geometry is None:
        return
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    if not isinstance(kind, str) or kind not in GEOMETRIES:
        raise SiteError(f"{place}: expected a GeoJSON geometry, got {_short(kind or geometry)}")
    member = "geometries" if kind == "GeometryCollection" else "coordinates"
    inside = geometry.get(member)
    if not isinstance(inside, list):
        raise SiteError(f"{place}: expected a list '{member}' in its {kind}, got {_short(inside)}")
    if kind == "GeometryCollection":
        for part in inside:
            yield from _polygons(part, place)
    elif kind == "MultiPolygon":
        yield from inside
    elif kind == "Polygon" and inside:
        yield inside


def _ring(ring: Any, place: str) -> np.ndarray:
    """Return a ring as (k, 2) degrees; a third coordinate, the height, is left out."""
    if not isinstance(ring, list):
        raise SiteError(f"{place}: expected a ring as a list of positions, got {_short(ring)}")
    for position in ring:
        numbers = position[:2] if isinstance(position, list) else []
        if len(numbers) < 2 or any(isinstance(v, bool) or not isinstance(v, int | float) for v in numbers):
            raise SiteError(f"{place}: expected a position [longitude, latitude], got {_short(position)}")
        if not all(abs(value) < 1e9 for value in numbers):  # nor are they NaN
            raise SiteError(f"{place}: expected finite coordinates, got {_short(position)}")
        if abs(numbers[0]) > 180 or abs(numbers[1]) >= 90:
            raise SiteError(f"{place}: expected longitude and latitude in degrees, got {_short(position)}")
    return np.array([position[:2] for position in ring], dtype=float).reshape(-1, 2)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
