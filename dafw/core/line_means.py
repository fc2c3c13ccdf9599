"""The mean of a field along a straight line, exact for fields that are linear on triangles.

A line from A to B has the points p(s) = A + s (B - A), 0 <= s <= 1. In a triangle with the barycentric coordinates
l_j, which are linear in s, it runs where all l_j(p(s)) >= 0: from s_0 to s_1. There the field sum_j l_j c_j is linear
in s, so its integral is (s_1 - s_0) times its value half way. The ends s_0, s_1 of all triangles divide the line into
pieces; each counts once, in one of the triangles that hold it, also where the line runs along an edge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dafw.core.errors import ConfigurationError
from dafw.core.space import Array, IntArray

ROUNDING = 1e-9
"""Share of a line that may be missing, and the barycentric coordinate that still counts as inside."""


def line_mean(nodes: Array, triangles: NDArray[np.int32], start: Array, end: Array) -> tuple[IntArray, Array]:
    """Return the nodes (k,) and the weights (k,), which add up to one, of the mean from ``start`` (2,) to ``end`` (2,).

    Args:
        nodes: (M, 2) in metres.
        triangles: (faces, 3) nodes of each triangle, in either sense.
        start: of the line, in metres.
        end: of the line; not the same point.

    Raises ConfigurationError if the line has no length, or leaves the mesh.
    """
    start, end = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    where = f"the line from ({start[0]:g}, {start[1]:g}) to ({end[0]:g}, {end[1]:g})"
    if (start == end).all():
        raise ConfigurationError(f"{where} has no length")
    low, high = np.minimum(start, end), np.maximum(start, end)
    corners = nodes[triangles]  # (faces, 3, 2)
    near = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    corners, faces = corners[near], triangles[near].astype(np.int64)
    at_start, at_end = _barycentric(corners, start), _barycentric(corners, end)
    first, last = _inside(at_start, at_end)
    met = last - first > ROUNDING
    first, last, faces = first[met], last[met], faces[met]
    at_start, at_end = at_start[met], at_end[met]
    ends = np.unique(np.concatenate([first, last])) if len(faces) else np.zeros(1)
    ends = ends[np.concatenate([[True], np.diff(ends) > ROUNDING])]
    middle, length = 0.5 * (ends[1:] + ends[:-1]), np.diff(ends)
    holds = (first[:, np.newaxis] <= middle) & (middle <= last[:, np.newaxis])
    covered = holds.any(axis=0) if len(faces) else np.zeros(0, dtype=np.bool_)
    total = float(length[covered].sum())
    if total < 1.0 - 10.0 * ROUNDING * max(1, len(length)):
        raise ConfigurationError(f"{where} leaves the mesh: {1.0 - total:.2g} of it lies outside")
    face, middle, length = holds.argmax(axis=0)[covered], middle[covered], length[covered] / total
    weights = at_start[face] + middle[:, np.newaxis] * (at_end[face] - at_start[face])
    found, places = np.unique(faces[face].ravel(), return_inverse=True)
    return found, np.bincount(places, (weights * length[:, np.newaxis]).ravel(), minlength=len(found))


def _barycentric(corners: Array, point: Array) -> Array:
    """Return the barycentric coordinates (faces, 3) of a point (2,) in triangles (faces, 3, 2)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    parts = np.stack([_cross(b - point, c - point), _cross(c - point, a - point), _cross(a - point, b - point)], axis=1)
    return np.asarray(parts / _cross(b - a, c - a)[:, np.newaxis])


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _inside(at_start: Array, at_end: Array) -> tuple[Array, Array]:
    """Return from where to where (faces,) a line is inside triangles; the second is below the first if it is not."""
    slope = at_end - at_start
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = -(at_start + ROUNDING) / slope
    rising, falling = slope > ROUNDING, slope < -ROUNDING
    first = np.where(rising, crossing, 0.0).max(axis=1)
    last = np.where(falling, crossing, 1.0).min(axis=1)
    never = (~rising & ~falling & (at_start < -ROUNDING)).any(axis=1)
    return np.maximum(first, 0.0), np.where(never, -1.0, np.minimum(last, 1.0))
