"""From an Overpass answer to GeoJSON features: ways, and multipolygons with the holes that they have.

OpenStreetMap keeps a ring with many corners as several ways. A multipolygon (a relation) lists the ways of its outer
and inner rings in any order and direction (https://wiki.openstreetmap.org/wiki/Relation:multipolygon). They are joined
at common ends. Rings may lie in rings: an island in a yard is an outer ring within an inner one. So, from the largest
ring to the smallest, outer rings are added and inner ones are taken away.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapely
from shapely.geometry import mapping

from dafw.core.errors import FetchError
from dafw.plugins.models.dispersion.site.area import DECIMALS, Area
from dafw.plugins.models.dispersion.site.osm_pages import words_of_page

KEPT = ("building", "man_made", "name", "height", "building:levels")
"""Tags that a feature keeps."""

OUTER, INNER = ("outer", "", "outline"), ("inner",)
"""Roles of the ways of a relation; ``outline`` is that of a building with parts."""

NO_RING = "without a closed outline"
NO_PLACE = "with a corner without a place"
ELSEWHERE = "outside the area that was asked for"
OTHER = "neither ways nor multipolygons"


@dataclass
class Found:
    """The buildings of an answer.

    Attributes:
        features: GeoJSON features, in the order of their kind and number.
        left_out: how many objects were left out, by the reason.
        incomplete: multipolygons of which some ways form no ring.
        date: of the data, as the server states it; empty if it does not.
    """

    features: list[dict[str, Any]] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)
    incomplete: int = 0
    date: str = ""


def read_answer(content: bytes, server: str, area: Area) -> Found:
    """Return the buildings of an answer; raises FetchError if it is no complete Overpass answer."""
    document = _document(content, server)
    found, seen = Found(date=_date(document)), set()
    for element in sorted(document["elements"], key=_order):
        kind, number = (element.get("type"), element.get("id")) if isinstance(element, dict) else (None, None)
        if kind not in ("way", "relation") or isinstance(number, bool) or not isinstance(number, int):
            found.left_out[OTHER] += 1
            continue
        if (kind, number) in seen:
            continue
        seen.add((kind, number))
        geometry = _outline(element) if kind == "way" else _multipolygon(element, found)
        if isinstance(geometry, str):
            found.left_out[geometry] += 1
        elif not area.meets(geometry.bounds):
            found.left_out[ELSEWHERE] += 1
        else:
            found.features.append(_feature(f"{kind}/{number}", element.get("tags"), geometry))
    return found


def _document(content: bytes, server: str) -> dict[str, Any]:
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        said = words_of_page(content[: 2**16])
        if content.lstrip()[:1] in (b"{", b"["):
            raise FetchError(f"{server}: the answer is no JSON, or was cut off after {len(content)} bytes") from None
        raise FetchError(f"{server}: expected JSON, got {f'a page that says: {said}' if said else 'nothing'}") from None
    if not isinstance(document, dict) or not isinstance(document.get("elements"), list):
        raise FetchError(f"{server}: expected the answer of an Overpass server, with a list 'elements'")
    remark = document.get("remark")
    if isinstance(remark, str) and "error" in remark.lower():  # such an answer has a part of the buildings
        said = words_of_page(remark.encode("utf-8", errors="replace"))
        raise FetchError(f"{server}: gave up ({said}); ask for a smaller area, or give it longer by --timeout")
    return document


def _date(document: Mapping[str, Any]) -> str:
    about = document.get("osm3s")
    date = about.get("timestamp_osm_base") if isinstance(about, dict) else None
    return date if isinstance(date, str) and len(date) <= 40 and date.isprintable() else ""


def _order(element: Any) -> tuple[bool, int]:
    """Return the place of an element among the others: ways first, then by number."""
    number = element.get("id") if isinstance(element, dict) else None
    return (isinstance(element, dict) and element.get("type") != "way"), number if isinstance(number, int) else 0


def _outline(way: Mapping[str, Any]) -> Any:
    """Return the polygon of a way, crossing itself if the way does; or why there is none."""
    ring = _positions(way.get("geometry"))
    if ring is None:
        return NO_PLACE
    if len(ring) < 4 or not np.array_equal(ring[0], ring[-1]):
        return NO_RING
    return shapely.Polygon(ring)


def _multipolygon(relation: Mapping[str, Any], found: Found) -> Any:
    """Return the area of a relation; or why there is none."""
    lines: dict[bool, list[Any]] = {True: [], False: []}
    members, unplaced, unjoined = relation.get("members"), False, False
    for member in members if isinstance(members, list) else []:
        role = member.get("role", "") if isinstance(member, dict) else None
        if role not in (*OUTER, *INNER) or member.get("type") != "way":
            continue
        line = _positions(member.get("geometry"))
        if line is None or len(line) < 2:
            unplaced = True
        else:
            lines[role in OUTER].append(shapely.LineString(line))
    rings = []
    for is_outer, some in lines.items():
        joined, *others = shapely.polygonize_full(shapely.get_parts(shapely.union_all(some)))
        unjoined = unjoined or not all(shapely.is_empty(other) for other in others)
        rings += [(shapely.Polygon(ring.exterior), is_outer) for ring in shapely.get_parts(joined)]
    area: Any = shapely.Polygon()
    for ring, is_outer in sorted(rings, key=lambda pair: -pair[0].area):
        area = area.union(ring) if is_outer else area.difference(ring)
    solid = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon" and not part.is_empty]
    if not solid:
        return NO_PLACE if unplaced else NO_RING
    found.incomplete += unplaced or unjoined
    return solid[0] if len(solid) == 1 else shapely.MultiPolygon(solid)


def _positions(geometry: Any) -> np.ndarray | None:
    """Return the corners (k, 2) of a way as longitude and latitude in degrees; None if one has no place."""
    corners: list[tuple[float, float]] = []
    for corner in geometry if isinstance(geometry, list) else [None]:
        place: Any = (corner.get("lon"), corner.get("lat")) if isinstance(corner, dict) else (None, None)
        if any(isinstance(degrees, bool) or not isinstance(degrees, int | float) for degrees in place):
            return None
        if not (abs(place[0]) <= 180 and abs(place[1]) < 90):  # nor are they NaN
            return None
        corners.append(place)
    return np.round(np.array(corners, dtype=float).reshape(-1, 2), DECIMALS)


def _feature(name: str, tags: Any, geometry: Any) -> dict[str, Any]:
    given = tags if isinstance(tags, dict) else {}
    # JSON may hold halves of characters, which no file in UTF-8 can.
    kept = {key: str(given[key]).encode("utf-8", "replace").decode() for key in KEPT if key in given}
    if geometry.is_valid:  # RFC 7946 wants outer rings counter-clockwise; of one that crosses itself nobody can say
        geometry = shapely.orient_polygons(geometry, exterior_cw=False)
    return {"type": "Feature", "id": name, "properties": kept, "geometry": _rounded(mapping(geometry))}


def _rounded(shape: Mapping[str, Any]) -> dict[str, Any]:
    def rounded(values: Any) -> Any:
        if isinstance(values, Iterable):
            return [rounded(value) for value in values]
        return round(float(values), DECIMALS)

    return {"type": shape["type"], "coordinates": rounded(shape["coordinates"])}
