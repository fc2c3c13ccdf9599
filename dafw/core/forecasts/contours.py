"""Where a field on triangles is above a threshold: polygons, contour lines, and GeoJSON of them.

The field is linear on each triangle, so the part of a triangle that is above the threshold is the triangle itself, a
smaller triangle or a quadrilateral. Places on a shared edge are computed from its nodes in the same order, so the parts
of neighbours fit together to the last bit, and shapely's union of a coverage joins them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dafw.core.geography import to_degrees
from dafw.core.space import Array

GRID = 1e-8
"""Degrees to which coordinates are rounded: about a millimetre."""


class Regions:
    """Finds where fields on a mesh exceed thresholds; the mesh's triangles are made into polygons once.

    ``nodes`` are (n, 2), ``triangles`` (faces, 3).

    >>> half = Regions(np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]]), np.array([[0, 1, 2]]))
    >>> half.above(np.array([0.0, 2.0, 0.0]), 1.0).area
    0.5
    """

    def __init__(self, nodes: Array, triangles: NDArray[np.int32]) -> None:
        import shapely

        self.nodes, self.triangles = nodes, triangles
        self._polygons = shapely.polygons(nodes[triangles])

    def above(self, values: Array, threshold: float) -> Any:
        """Return where the field ``values`` (n,) exceeds a threshold, as a shapely polygon or multipolygon."""
        import shapely

        nodes = self.nodes
        whole = (values > threshold)[self.triangles].all(axis=1)
        parts = [self._polygons[whole]] if whole.any() else []
        for number in (1, 2):
            (a, b, c), ab, ac = _cut(nodes, self.triangles, values, threshold, number)
            corners = [nodes[a], ab, ac] if number == 1 else [ab, nodes[b], nodes[c], ac]
            parts += [shapely.polygons(np.stack(corners, axis=1))] if len(ab) else []
        return shapely.coverage_union_all(np.concatenate(parts)) if parts else shapely.MultiPolygon()


def contour_of(nodes: Array, triangles: NDArray[np.int32], values: Array, threshold: float) -> Array:
    """Return where the field equals a threshold, as segments (k, 2, 2): not along walls or the edge of the mesh."""
    pieces = [_cut(nodes, triangles, values, threshold, number)[1:] for number in (1, 2)]
    return np.concatenate([np.stack(piece, axis=1) for piece in pieces])


def _cut(nodes: Array, triangles: NDArray[np.int32], values: Array, threshold: float, number: int) -> Any:
    """Return the triangles that have so many corners, 1 or 2, above a threshold, and where the threshold cuts them.

    The corners (a, b, c), each (k,), in the triangles' orientation: a is alone on its side. The cuts (k, 2) lie on the
    edges ab and ac.
    """
    above = values - threshold
    inside = above > 0.0
    some = triangles[inside[triangles].sum(axis=1) == number]
    alone = np.argmax(inside[some] == (number == 1), axis=1)
    a, b, c = (np.take_along_axis(some, ((alone + turn) % 3)[:, np.newaxis], axis=1)[:, 0] for turn in range(3))
    return (a, b, c), _crossing(nodes, above, a, b), _crossing(nodes, above, a, c)


def _crossing(nodes: Array, above: Array, i: Any, j: Any) -> Array:
    """Return where the field is zero on the edges from nodes i to nodes j, one inside and one outside, (k, 2)."""
    first, last = np.minimum(i, j), np.maximum(i, j)
    share = above[first] / (above[first] - above[last])
    places = nodes[first] + share[:, np.newaxis] * (nodes[last] - nodes[first])
    # Where the last node itself is the crossing, rounding would move it a little from edge to edge.
    return np.asarray(np.where((above[last] == 0.0)[:, np.newaxis], nodes[last], places))


def joined(segments: Array) -> Any:
    """Return the segments (k, 2, 2) of a contour as one shapely line or several; closed where the contour is."""
    import shapely

    long = segments[(segments[:, 0] != segments[:, 1]).any(axis=1)]
    return shapely.line_merge(shapely.multilinestrings(shapely.linestrings(long)))


def lines_in_degrees(lines: Any, origin: tuple[float, float]) -> Any:
    """Return lines in metres in longitude and latitude."""
    import shapely

    return shapely.set_precision(shapely.transform(lines, lambda metres: to_degrees(metres, origin)), GRID)


def in_degrees(polygon: Any, origin: tuple[float, float]) -> Any:
    """Return a polygon in metres in longitude and latitude, valid, with outer rings counter-clockwise (RFC 7946)."""
    import shapely

    moved = shapely.transform(polygon, lambda metres: to_degrees(metres, origin))
    moved = shapely.set_precision(shapely.make_valid(moved), GRID)
    parts = [part for part in shapely.get_parts(moved) if part.geom_type in ("Polygon", "MultiPolygon")]
    return shapely.orient_polygons(shapely.MultiPolygon(_flat(parts)))


def _flat(parts: Sequence[Any]) -> list[Any]:
    import shapely

    return [one for part in parts for one in shapely.get_parts(part)]


def feature(shape: Any, properties: Mapping[str, Any]) -> dict[str, Any]:
    """Return a GeoJSON feature of a polygon or of lines in degrees; numbers that are not finite become null."""
    import shapely

    plain = {
        name: None if isinstance(value, float) and not np.isfinite(value) else value
        for name, value in properties.items()
    }
    return {"type": "Feature", "properties": plain, "geometry": json.loads(shapely.to_geojson(shape))}


def collection(features: Sequence[Mapping[str, Any]]) -> str:
    """Return the text of a GeoJSON file."""
    return json.dumps({"type": "FeatureCollection", "features": list(features)}, allow_nan=False) + "\n"
