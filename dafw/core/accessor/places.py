"""Values of a field at places and along lines, linear between the nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from xarray import DataArray, Dataset

from dafw.core.accessor.by_row import by_row
from dafw.core.accessor.contents import field_of, mesh_of, node_dim, nodes_of
from dafw.core.errors import RunError
from dafw.core.interpolation import arc_lengths, barycentric, in_triangles, points_along, weights_at
from dafw.core.space import Array, IntArray, Variable

SKIN = 1e-3
"""Distance in metres from the mesh at which a point still counts as being on it: walls are rounded numbers."""


def at(run: Dataset, field: str | DataArray, points: Any) -> DataArray:
    """Return a field at points: see ``RunAccessor.at``."""
    return _at(run, field_of(run, field), _points(points), "point")


def along(run: Dataset, field: str | DataArray, line: Any, step: float) -> DataArray:
    """Return a field along a line: see ``RunAccessor.along``."""
    corners = _points(line.coords if hasattr(line, "coords") else line)
    length = float(arc_lengths(corners)[-1])
    if not (step > 0.0 and length > 0.0):
        raise RunError(f"a line needs a length and a step above zero, got a length of {length:g} m and step={step}")
    # The last step may be shorter, but not by rounding alone.
    lengths = np.append(np.arange(0.0, length - 1e-9 * length, step), length)
    found = _at(run, field_of(run, field), points_along(corners, lengths), "distance")
    return found.assign_coords(distance=("distance", lengths, {"units": "m", "long_name": "distance along the line"}))


def _at(run: Dataset, values: DataArray, points: Array, dim: str) -> DataArray:
    nodes = nodes_of(run, values)
    if nodes.shape[1] != points.shape[1]:
        raise RunError(f"the run's nodes have {nodes.shape[1]} coordinates, the points have {points.shape[1]}")
    if nodes.shape[1] == 1:
        corners, weights = weights_at(Variable("x", len(nodes), coordinates=nodes), None, points)
        outside = (points[:, 0] < nodes.min()) | (points[:, 0] > nodes.max())
        weights = np.where(outside[:, np.newaxis], np.nan, weights)
    else:
        corners, weights = mesh_weights(*mesh_of(run, values), points)

    def interpolated(row: Array) -> Array:
        return np.asarray((row[corners] * weights).sum(axis=1))

    found = by_row(interpolated, [values], [[str(node_dim(values))]], [dim], {dim: len(points)})
    axes = {f"{dim}_{axis}": (dim, column, {"units": "m"}) for axis, column in zip("xy", points.T, strict=False)}
    return found.rename(values.name).assign_attrs(values.attrs).assign_coords(axes)


def mesh_weights(nodes: Array, triangles: NDArray[np.int32], points: Array) -> tuple[IntArray, Array]:
    """Return the corners (m, 3) of the triangles that hold points (m, 2), and weights (m, 3); NaN outside the mesh.

    A point within ``SKIN`` of the mesh takes the value of its edge.
    """
    import shapely

    inside, corners, weights = in_triangles(nodes, triangles, points)
    lost = np.flatnonzero(~inside)
    if len(lost):
        weights[lost] = np.nan
        tree = shapely.STRtree(shapely.polygons(nodes[triangles]))
        which, face = tree.query_nearest(shapely.points(points[lost]), max_distance=SKIN, all_matches=False)
        near = lost[which]
        corners[near] = triangles[face]
        held = np.maximum(barycentric(nodes[corners[near]], points[near]), 0.0)
        weights[near] = held / held.sum(axis=1, keepdims=True)
    return corners, weights


def _points(points: Any) -> Array:
    """Return points (m, d) in metres; raises RunError if they are not."""
    try:
        found = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.empty(0)
    found = found[np.newaxis] if found.ndim == 1 and found.size else found
    if found.ndim != 2 or not found.size or not np.isfinite(found).all():
        raise RunError(f"points must be finite numbers (m, 2) in metres, got {str(points)[:80]}")
    return found
