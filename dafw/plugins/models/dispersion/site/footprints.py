"""Prepare footprints for meshing: repair rings, merge neighbours, close gaps, remove slivers and small buildings.

All overlays snap to a grid of 1 mm, so that walls that two footprints share stay shared. Offsets have mitred corners,
so that an offset outwards and the same offset inwards give back sharp corners and the same walls.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely
from shapely import Polygon

GRID = 1e-3
"""Spacing in m of the grid to which overlays snap."""

NOTICEABLE = 0.01
"""m^2; a smaller footprint or overlap is ignored."""

THINNEST, SHORTEST = 1 / 4, 1 / 8
"""Thinner parts of a building and shorter sides are removed; both as fractions of the narrowest gap."""


@dataclass(frozen=True)
class Footprint:
    """A polygon in metres, with the name and the kind of the building."""

    polygon: Polygon
    name: str
    kind: str


def repair(rings: list[np.ndarray], report: dict[str, int]) -> list[Polygon]:
    """Return the valid polygons without holes that some rings describe.

    Args:
        rings: the shell and then its holes, each (k, 2), in m.
        report: counts of what was done, which this adds to.
    """
    usable = [ring for ring in rings if len(np.unique(ring, axis=0)) >= 3]
    report["degenerate"] += len(rings) - len(usable)
    if not usable or usable[0] is not rings[0]:
        return []
    polygon = shapely.Polygon(usable[0])
    report["holes_filled"] += len(usable) - 1
    if polygon.is_valid:
        return [polygon] if polygon.area > NOTICEABLE else _nothing(report)
    solid = shapely.make_valid(polygon, method="structure", keep_collapsed=False)
    parts = [shapely.Polygon(part.exterior) for part in _polygons(solid) if part.area > NOTICEABLE]
    report["repaired"] += bool(parts)
    return parts or _nothing(report)


def _nothing(report: dict[str, int]) -> list[Polygon]:
    report["degenerate"] += 1
    return []


def arrange(
    footprints: list[Footprint], room: Polygon, rim: float, gap: float, report: dict[str, int]
) -> list[Footprint]:
    """Return the buildings inside ``room``; they are disjoint and at least about ``gap`` apart.

    Args:
        footprints: those of the file.
        room: the rectangle in which buildings may stand.
        rim: width in m of the free strip around it.
        gap: narrowest gap in m between two buildings.
        report: counts of what was done, which this adds to.
    """
    inside = _clip(footprints, room, report)
    solid = _areas(shapely.union_all([footprint.polygon for footprint in inside], grid_size=GRID))
    thick = _opened(solid, THINNEST * gap)
    report["slivers_removed"] = _pieces(solid, thick)
    limits = room.buffer(rim, join_style="mitre")
    closed, parts = thick, -1
    while len(closed.geoms) != parts:  # a filled gap may leave another too narrow; every round has fewer parts
        parts = len(closed.geoms)
        closed = _closed(_bridged(_polygons(closed), gap), limits, gap)
    report["gaps_closed"] = _pieces(closed, thick)

    buildings = [_labelled(polygon, inside) for polygon in _polygons(closed)]
    report["merged"] = sum(len(sources) - 1 for _, sources in buildings)
    large = [(polygon, sources) for polygon, sources in buildings if polygon.area >= gap**2]
    report["little_removed"] = len(buildings) - len(large)
    kept = []
    for polygon, sources in sorted(large, key=lambda building: building[1]):
        simple, removed = _without_short_sides(polygon, SHORTEST * gap)
        report["corners_removed"] += removed
        kept.append(
            Footprint(
                polygon=shapely.normalize(simple),
                name=" + ".join(dict.fromkeys(inside[source].name for source in sources)),
                kind=" + ".join(dict.fromkeys(inside[source].kind for source in sources)),
            )
        )
    report["buildings"] = len(kept)
    return kept


def _clip(footprints: list[Footprint], room: Polygon, report: dict[str, int]) -> list[Footprint]:
    """Cut footprints at the edge of ``room``.

    No building may touch the outer boundary: the wind is prescribed all round, and inflow must equal outflow.
    """
    inside = []
    for footprint in footprints:
        cut = _areas(footprint.polygon.intersection(room))
        if cut.area <= NOTICEABLE:
            report["outside"] += 1
        else:
            report["clipped"] += not room.buffer(GRID).covers(footprint.polygon)
            inside.append(replace(footprint, polygon=cut))
    return inside


def _opened(solid: Any, width: float) -> Any:
    """Remove parts that are thinner than ``width`` in m (morphological opening)."""
    core = _offset(solid, -width / 2)
    return _areas(shapely.intersection(_offset(core, width / 2), solid, grid_size=GRID))


def _bridged(parts: list[Polygon], gap: float) -> Any:
    """Join parts that are closer than ``gap`` in m where they are closest.

    Morphological closing alone does not join two corners that face each other.
    """
    bridges = []
    tree, within = shapely.STRtree(parts), gap * (1 - 1e-9)
    near_pairs = tree.query(np.asarray(parts, dtype=object), predicate="dwithin", distance=within)
    for first, second in near_pairs.T:
        if first < second:
            line = shapely.shortest_line(parts[first], parts[second])
            near = shapely.box(*line.centroid.buffer(gap).bounds)
            ends = [shapely.convex_hull(near.intersection(parts[part])) for part in (first, second)]
            bridges.append(shapely.convex_hull(shapely.union_all(ends)))
    return _areas(shapely.union_all([*parts, *bridges], grid_size=GRID))


def _closed(solid: Any, limits: Polygon, gap: float) -> Any:
    """Fill the free space that a disc of diameter ``gap``, in m, cannot reach from the limits.

    This fills narrow gaps, yards behind a narrow mouth, and yards without a mouth. It is a morphological closing
    followed by a reconstruction of the free space from its outermost part.
    """
    free = limits.difference(solid, grid_size=GRID)
    reachable = _polygons(_offset(free, -gap / 2))
    outermost = max(reachable, key=lambda part: shapely.Polygon(part.exterior).area)
    wide = shapely.intersection(_offset(outermost, gap / 2), free, grid_size=GRID)
    open_space = max(_polygons(wide), key=lambda part: shapely.Polygon(part.exterior).area)
    return shapely.MultiPolygon([shapely.Polygon(hole) for hole in open_space.interiors])


def _labelled(polygon: Polygon, sources: list[Footprint]) -> tuple[Polygon, list[int]]:
    """Return the building with the indices of the footprints that it was made from."""
    overlap = shapely.area(shapely.intersection(polygon, [source.polygon for source in sources]))
    return polygon, np.flatnonzero(overlap > NOTICEABLE).tolist()


def _without_short_sides(polygon: Polygon, shortest: float) -> tuple[Polygon, int]:
    """Remove corners until no side is shorter than ``shortest`` in m; return the polygon and how many were removed.

    In every round one end of the shortest side goes: the one that spans the smaller triangle with its neighbours.
    """
    straight = polygon.simplify(2 * GRID)
    corners = np.asarray(straight.exterior.coords)[:-1]
    while len(corners) > 3:
        sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        start = int(np.argmin(sides))
        if sides[start] >= shortest:
            break
        ends = (start, (start + 1) % len(corners))
        spans = [shapely.Polygon(corners[[end - 1, end, (end + 1) % len(corners)]]).area for end in ends]
        corners = np.delete(corners, ends[int(np.argmin(spans))], axis=0)
    simple = shapely.Polygon(corners)
    if not (simple.is_valid and simple.area > NOTICEABLE):
        return straight, 0
    return simple, len(straight.exterior.coords) - len(simple.exterior.coords)


def _offset(geometry: Any, distance: float) -> Any:
    moved = shapely.buffer(geometry, distance, join_style="mitre", mitre_limit=10.0)
    return moved if moved.is_valid else _areas(shapely.make_valid(moved, method="structure", keep_collapsed=False))


def _polygons(geometry: Any) -> list[Polygon]:
    return [part for part in shapely.get_parts(geometry) if part.geom_type == "Polygon" and not part.is_empty]


def _areas(geometry: Any) -> Any:
    """Drop the points and lines that an overlay may return beside polygons."""
    return shapely.MultiPolygon(_polygons(geometry))


def _pieces(larger: Any, smaller: Any) -> int:
    """Count the pieces of a difference, without the slivers that snapping to the grid makes."""
    return len(_polygons(_offset(shapely.difference(larger, smaller, grid_size=GRID), -2 * GRID)))
