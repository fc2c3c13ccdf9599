"""The domain of a model: a rectangle with obstacles, used by vehicles, observers, records and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dafw.core.space import Array

if TYPE_CHECKING:
    from dafw.core.ways import Ways

GRID = 80
"""Steps of the grid of ``Domain.ways`` along the longer side."""
SKIN = 1e-3
"""Depth in metres to which an obstacle may be touched, and width of the rectangle's edge."""


def node_areas(nodes: Array, triangles: NDArray[Any]) -> Array:
    """Return the area (M,) that belongs to each of the nodes (M, 2): a third of its triangles (faces, 3).

    The sum of areas times values is the integral of a field that is linear in the triangles.
    """
    a, b, c = np.moveaxis(nodes[triangles], 1, 0)
    areas = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (c - a)[:, 0] * (b - a)[:, 1])
    return np.asarray(np.bincount(triangles.ravel(), np.repeat(areas / 3.0, 3), minlength=len(nodes)))


@dataclass(frozen=True, eq=False)
class Domain:
    """A rectangle ``bounds`` (x_min, y_min, x_max, y_max) in metres with polygonal obstacles.

    ``obstacles`` are rings (k, 2) without the closing point; ``triangles`` (faces, 3) connect the nodes of the model's
    first variable, counter-clockwise; ``landmarks`` are named points for pictures. ``origin`` is the longitude and
    latitude of (0, 0) in degrees; None if the plane has no place on Earth.
    """

    bounds: tuple[float, float, float, float]
    obstacles: tuple[Array, ...] = ()
    obstacle_names: tuple[str, ...] = ()
    triangles: NDArray[np.int32] | None = None
    landmarks: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    origin: tuple[float, float] | None = None

    @cached_property
    def _polygons(self) -> Any:
        from shapely import Polygon

        return np.array([Polygon(ring) for ring in self.obstacles], dtype=object)

    @cached_property
    def _tree(self) -> Any:
        from shapely import STRtree

        return STRtree(self._polygons)

    @cached_property
    def _boxes(self) -> Array:
        """The bounding boxes of the obstacles, (4, K): x_min, y_min, x_max, y_max."""
        return np.array([[*ring.min(axis=0), *ring.max(axis=0)] for ring in self.obstacles]).reshape(-1, 4).T.copy()

    def contains(self, point: Array | tuple[float, float]) -> bool:
        """Return whether a point (2,) lies inside the rectangle or on its edge."""
        x_min, y_min, x_max, y_max = self.bounds
        return bool(x_min <= point[0] <= x_max and y_min <= point[1] <= y_max)

    def is_free(self, start: Array, end: Array) -> bool:
        """Return whether the segment from ``start`` (2,) to ``end`` (2,) stays inside and touches no obstacle."""
        (x, y), (x_end, y_end) = map(float, start), map(float, end)
        if not (self.contains((x, y)) and self.contains((x_end, y_end))):
            return False
        x_min, y_min, x_max, y_max = self._boxes
        # Most segments are far from all obstacles; the bounding boxes show that without a call of shapely.
        near = (x_min <= max(x, x_end)) & (x_max >= min(x, x_end)) & (y_min <= max(y, y_end)) & (y_max >= min(y, y_end))
        return not (near.any() and self._touches(near, start, end))

    def hindrance(self, start: Array, end: Array) -> str | None:
        """Return what keeps a vehicle from flying from ``start`` (2,) to ``end`` (2,); None if the way is free.

        The name of an obstacle that the segment touches, the nearest one to ``start``, or ``the edge of the domain``.
        """
        import shapely

        if self.is_free(start, end):
            return None
        if not (self.contains(start) and self.contains(end)):
            return "the edge of the domain"
        met = np.flatnonzero(shapely.intersects(self._polygons, shapely.linestrings([start, end])))
        nearest = int(met[np.argmin(shapely.distance(self._polygons[met], shapely.points(start)))])
        name = self.obstacle_names[nearest] if nearest < len(self.obstacle_names) else ""
        return name or f"obstacle {nearest}"

    def are_free(self, starts: Array, ends: Array) -> NDArray[np.bool_]:
        """Return ``is_free`` (k,) for many segments at once, from ``starts`` to ``ends``, both (k, 2)."""
        import shapely

        low, high = np.array(self.bounds[:2]), np.array(self.bounds[2:])
        free = np.logical_and.reduce([((low <= ends_) & (ends_ <= high)).all(axis=1) for ends_ in (starts, ends)])
        if len(self.obstacles):
            still = (starts == ends).all(axis=1)
            flown = np.where(still, shapely.points(starts), shapely.linestrings(np.stack([starts, ends], axis=1)))
            free[self._tree.query(flown, predicate="intersects")[0]] = False
        return np.asarray(free)

    @cached_property
    def _cores(self) -> Any:
        """The obstacles without their outermost millimetres, so that a segment along a wall does not meet them."""
        import shapely

        return shapely.STRtree(shapely.buffer(self._polygons, -SKIN))

    def are_inside(self, points: Array) -> NDArray[np.bool_]:
        """Return which of the points (m, 2) lie inside the rectangle or a millimetre beside it: nodes are rounded."""
        low, high = np.array(self.bounds[:2]) - SKIN, np.array(self.bounds[2:]) + SKIN
        return np.asarray(((low <= points) & (points <= high)).all(axis=1))

    def are_in_obstacles(self, points: Array) -> NDArray[np.bool_]:
        """Return which of the points (m, 2) lie inside an obstacle; its wall, a millimetre deep, is not inside."""
        import shapely

        inside = np.zeros(len(points), dtype=np.bool_)
        if len(self.obstacles) and len(points):
            inside[self._cores.query(shapely.points(points), predicate="intersects")[0]] = True
        return inside

    def distances(self, place: Array, ends: Array, within: float) -> Array:
        """Return the lengths (m,) in metres of the ways around the obstacles from ``place`` (2,) to ``ends`` (m, 2).

        Infinite for a way that is longer than ``within``. Where the straight segment passes through no obstacle, it is
        the way; places on walls are allowed. Other ways are those of ``ways``, a little longer than the shortest.
        """
        import shapely

        straight = np.linalg.norm(ends - place, axis=1)
        lengths = np.where(straight <= within, straight, np.inf)
        near = np.flatnonzero((straight <= within) & (straight > 0.0))
        if not len(self.obstacles) or not len(near):
            return lengths
        segments = shapely.linestrings(np.stack([np.broadcast_to(place, (len(near), 2)), ends[near]], axis=1))
        hidden = near[np.unique(self._cores.query(segments, predicate="intersects")[0])]
        if len(hidden):
            around = np.maximum(self.ways.lengths(place, ends[hidden]), straight[hidden])
            lengths[hidden] = np.where(around <= within, around, np.inf)
        return lengths

    @cached_property
    def ways(self) -> Ways:
        """Shortest ways around the obstacles, on a grid; made when first asked for."""
        from dafw.core.ways import ways_in

        x_min, y_min, x_max, y_max = self.bounds
        return ways_in(self, max(x_max - x_min, y_max - y_min) / GRID)

    def _touches(self, near: NDArray[np.bool_], start: Array, end: Array) -> bool:
        """Return whether the segment touches one of the obstacles marked in ``near`` (K,)."""
        import shapely

        flown = shapely.points(start) if np.array_equal(start, end) else shapely.linestrings([start, end])
        return bool(shapely.intersects(self._polygons[near], flown).any())
