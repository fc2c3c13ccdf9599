"""Longitude and latitude in a plane: linearised about a point, with the metres per degree of the WGS84 ellipsoid."""

from __future__ import annotations

import numpy as np

from dafw.core.space import Array


def metres_per_degree(latitude: float) -> tuple[float, float]:
    """Return the metres per degree of longitude and of latitude on the WGS84 ellipsoid at a latitude in degrees."""
    from pyproj import Geod

    ellipsoid, half = Geod(ellps="WGS84"), 0.005
    east = ellipsoid.line_length([-half, half], [latitude, latitude])
    north = ellipsoid.line_length([0.0, 0.0], [latitude - half, latitude + half])
    return east / (2 * half), north / (2 * half)


def to_metres(degrees: Array, origin: tuple[float, float]) -> Array:
    """Return longitudes and latitudes (..., 2) in degrees as metres (..., 2) east and north of ``origin``.

    ``origin`` is the longitude and latitude of the plane's (0, 0). Longitudes may count from -180 or from 0.
    """
    off = np.asarray(degrees, dtype=np.float64) - origin
    off[..., 0] = np.where(np.abs(off[..., 0]) > 180.0, (off[..., 0] + 180.0) % 360.0 - 180.0, off[..., 0])
    return np.asarray(off * metres_per_degree(origin[1]))


def to_degrees(metres: Array, origin: tuple[float, float]) -> Array:
    """Return places (..., 2) in metres east and north of ``origin`` as longitudes and latitudes in degrees."""
    return np.asarray(np.asarray(metres, dtype=np.float64) / metres_per_degree(origin[1]) + origin)
