"""How far two contours are from each other."""

from __future__ import annotations

import numpy as np

from dafw.core.space import Array


def contour_distance(one: Array, other: Array) -> float:
    """Return the mean distance between two contours, segments (k, 2, 2) and (m, 2, 2) in metres.

    It is the mean over the length of one of the distance to the nearest point of the other, averaged with the same the
    other way round ("average symmetric surface distance"). Infinite if one of the contours is empty, NaN if both are.
    """
    if not len(one) and not len(other):
        return float("nan")
    if not len(one) or not len(other):
        return float("inf")
    return 0.5 * (_mean_distance(one, other) + _mean_distance(other, one))


def _mean_distance(one: Array, other: Array) -> float:
    """Return the mean distance of the segments' middles to another contour, weighted by their lengths."""
    import shapely

    middles, lengths = one.mean(axis=1), np.linalg.norm(one[:, 1] - one[:, 0], axis=1)
    if not lengths.any():  # a contour that is a point
        lengths = np.ones(len(one))
    tree = shapely.STRtree(shapely.linestrings(other))
    _, distance = tree.query_nearest(shapely.points(middles), return_distance=True, all_matches=False)
    return float(np.average(distance, weights=lengths))
