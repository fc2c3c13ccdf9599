"""The domain of a model: a rectangle with obstacles, used by vehicles, observers, records and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dafw.core.space import Array


@dataclass(frozen=True, eq=False)
class Domain:
    """A rectangle ``bounds`` (x_min, y_min, x_max, y_max) in metres with polygonal obstacles.

    ``obstacles`` are rings (k, 2) without the closing point; ``triangles`` (faces, 3) connect the nodes of the model's
    first variable, counter-clockwise; ``landmarks`` are named points for pictures.
    """

    bounds: tuple[float, float, float, float]
    obstacles: tuple[Array, ...] = ()
    obstacle_names: tuple[str, ...] = ()
    triangles: NDArray[np.int32] | None = None
    landmarks: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @cached_property
    def _polygons(self) -> Any:
        from shapely import Polygon

        return np.array([Polygon(ring) for ring in self.obstacles], dtype=object)

    @cached_property
    def _boxes(self) -> tuple[Array, Array]:
        """The lowest and the highest corners of the obstacles' bounding boxes, both (K, 2)."""
        lowest = np.array([ring.min(axis=0) for ring in self.obstacles]).reshape(-1, 2)
        highest = np.array([ring.max(axis=0) for ring in self.obstacles]).reshape(-1, 2)
        return lowest, highest

    def contains(self, point: Array) -> bool:
        """Return whether a point (2,) lies inside the rectangle or on its edge."""
        x_min, y_min, x_max, y_max = self.bounds
        return bool(x_min <= point[0] <= x_max and y_min <= point[1] <= y_max)

    def is_free(self, start: Array, end: Array) -> bool:
        """Return whether the segment from ``start`` (2,) to ``end`` (2,) stays inside and touches no obstacle."""
        if not (self.contains(start) and self.contains(end)):
            return False
        lowest, highest = self._boxes
        # Most segments are far from all obstacles; the bounding boxes show that without a call of shapely.
        near = ((lowest <= np.maximum(start, end)) & (highest >= np.minimum(start, end))).all(axis=1)
        return not (near.any() and self._touches(near, start, end))

    def _touches(self, near: NDArray[np.bool_], start: Array, end: Array) -> bool:
        """Return whether the segment touches one of the obstacles marked in ``near`` (K,)."""
        import shapely

        flown = shapely.points(start) if np.array_equal(start, end) else shapely.linestrings([start, end])
        return bool(shapely.intersects(self._polygons[near], flown).any())
