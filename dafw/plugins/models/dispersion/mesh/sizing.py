"""How long the sides of the triangles are at every place of a site.

Points on the walls ask for a size: the wall size, or less if the side of the building is shorter or a passage is
narrower. With the distance from such a point the size grows linearly, up to the far size. At every place the smallest
of these sizes is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import shapely

from dafw.plugins.models.dispersion.mesh.options import MeshOptions
from dafw.plugins.models.dispersion.site.site import Site

SMALLEST = 1 / 4
"""Smallest side of a triangle in a narrow passage, as a fraction of the wall size."""

STEEPEST = 0.3
"""Growth of the size, in m per m of distance, from points that ask for less than the wall size.

A steeper growth makes badly shaped triangles.
"""


def size_function(site: Site, options: MeshOptions) -> Callable[[int, int, float, float, float, float], float]:
    """Return the size callback for gmsh: (dimension, tag, x, y, z, gmsh's own size) -> size in m."""
    points, sizes = demands(site, options)
    growth = np.where(sizes < options.wall_size, max(_growth(options), STEEPEST), _growth(options))
    x_demand, y_demand = points.T.copy()
    far = options.far_size

    def size(dimension: int, tag: int, x: float, y: float, z: float, otherwise: float) -> float:
        return min(far, float(np.min(sizes + growth * np.hypot(x_demand - x, y_demand - y), initial=far)))

    return size


def demands(site: Site, options: MeshOptions) -> tuple[np.ndarray, np.ndarray]:
    """Return points (k, 2) in m on the walls, and the size (k,) in m that each asks for."""
    points, outward, sizes = [np.empty((0, 2))], [np.empty((0, 2))], [np.empty(0)]
    for building in site.buildings:
        ring = np.asarray(shapely.orient_polygons(building, exterior_cw=False).exterior.coords)
        for start, end in pairwise(ring):
            side, length = end - start, math.dist(start, end)
            pieces = math.ceil(2 * length / options.wall_size)
            along = (np.arange(pieces) + 0.5)[:, None] / pieces
            points.append(start + along * side)
            outward.append(np.tile(np.array([side[1], -side[0]]) / length, (pieces, 1)))
            sizes.append(np.full(pieces, min(options.wall_size, length)))
    walls, normals, wanted = np.concatenate(points), np.concatenate(outward), np.concatenate(sizes)
    facing = _room_in_front(walls, normals, options.across * options.wall_size, site)
    corners, apart = _between_buildings(site, options.across * options.wall_size)
    smallest = SMALLEST * options.wall_size
    wanted = np.minimum(wanted, np.maximum(facing / options.across, smallest))
    return np.concatenate([walls, corners]), np.concatenate([wanted, np.maximum(apart / options.across, smallest)])


def _room_in_front(points: np.ndarray, outward: np.ndarray, reach: float, site: Site) -> np.ndarray:
    """Return the distance (k,) in m from points on walls to the wall opposite; infinite beyond ``reach``.

    Args:
        points: (k, 2) places on walls, in m.
        outward: (k, 2) unit normals of the walls, pointing away from the building.
        reach: the longest distance to look for, in m.
        site: the site.
    """
    if not len(points):
        return np.empty(0)
    boundary = site.domain.boundary
    shapely.prepare(boundary)
    starts = points + 1e-6 * reach * outward
    rays = shapely.linestrings(np.stack([starts, points + reach * outward], axis=1))
    distance = shapely.distance(shapely.points(starts), shapely.intersection(rays, boundary))
    return np.where(np.isnan(distance), np.inf, distance)


def _between_buildings(site: Site, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the places (k, 2) where buildings are closest to each other, and their distance (k,), in m.

    Pairs of buildings that are farther apart than ``reach``, in m, are left out.
    """
    buildings = np.asarray(site.buildings, dtype=object)
    if not len(buildings):
        return np.empty((0, 2)), np.empty(0)
    first, second = shapely.STRtree(buildings).query(buildings, predicate="dwithin", distance=reach)
    lines = shapely.shortest_line(buildings[first[first < second]], buildings[second[first < second]])
    ends = shapely.get_coordinates(lines).reshape(-1, 2)
    return ends, np.repeat(shapely.length(lines), 2)


def expected_nodes(site: Site, options: MeshOptions) -> float:
    """Estimate the number of nodes.

    The triangles are taken as equilateral, two per node. Strips along the walls have small triangles, the rest has the
    far size. If the free space is too small for strips of full depth, they are narrowed. Narrow passages and short
    sides are not considered.
    """
    walls, area = sum(building.length for building in site.buildings), site.domain.area
    depth = min(options.transition, area / walls) if walls else 0.0
    outermost = options.wall_size + _growth(options) * depth
    strips = walls * depth / (options.wall_size * outermost)
    return (strips + (area - walls * depth) / options.far_size**2) * 2 / math.sqrt(3)


def _growth(options: MeshOptions) -> float:
    return (options.far_size - options.wall_size) / options.transition
