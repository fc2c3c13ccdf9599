"""The site: building footprints turned into a rectangle in metres with solid, well-separated buildings in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from shapely import Polygon, box

from dafw.core.errors import SiteError
from dafw.core.geography import metres_per_degree
from dafw.plugins.models.dispersion.site.footprints import Footprint, arrange, repair
from dafw.plugins.models.dispersion.site.geojson import read_outlines
from dafw.plugins.models.dispersion.site.options import SiteOptions

LONGEST_SIDE = 20e3
"""m; on a longer rectangle linearised longitudes and latitudes are off by more than a few parts in a thousand."""

SMALLEST_OPEN_FRACTION = 0.05
"""Smallest part of the rectangle within the rim that must be free of buildings."""

REPORT = {
    "features": "features read",
    "not_buildings": "features ignored: not a building",
    "untagged": "polygons taken for buildings: no feature of the file is tagged as one",
    "without_polygon": "buildings ignored: no polygon in their geometry",
    "degenerate": "rings dropped: fewer than three corners, or no area",
    "footprints": "footprints found",
    "repaired": "footprints repaired: their rings crossed themselves",
    "holes_filled": "holes in footprints filled",
    "outside": "footprints dropped: outside the limits, or only in the rim",
    "clipped": "footprints cut at the inner edge of the rim",
    "slivers_removed": "slivers and fins removed",
    "merged": "footprints merged into a neighbour",
    "gaps_closed": "gaps, passages and yards closed",
    "little_removed": "buildings removed: too small for the mesh",
    "corners_removed": "corners removed: too close to the next one",
    "buildings": "buildings kept",
}
"""What the counts of ``Site.report`` mean, in the order in which a site is made."""


@dataclass(frozen=True)
class Site:
    """A rectangle in metres about the centre of the site, and the buildings in it.

    The buildings are valid polygons without holes. They do not touch each other or the rim of the rectangle, and the
    free space around them is one connected region.

    Attributes:
        bounds: (x_min, y_min, x_max, y_max) in m, x to the east and y to the north.
        buildings: their polygons in m.
        names: their names.
        types: their kinds, from the tags of the file.
        origin: (longitude, latitude) of the centre in degrees.
        scale: metres per degree of longitude and of latitude.
        report: how often each step of ``REPORT`` was needed.
    """

    bounds: tuple[float, float, float, float]
    buildings: tuple[Polygon, ...]
    names: tuple[str, ...]
    types: tuple[str, ...]
    origin: tuple[float, float]
    scale: tuple[float, float]
    report: Mapping[str, int]

    @property
    def domain(self) -> Polygon:
        """The free space: the rectangle with the buildings as holes."""
        return Polygon(box(*self.bounds).exterior, [building.exterior for building in self.buildings])

    def to_metres(self, degrees: Any) -> np.ndarray:
        """Convert (..., 2) longitudes and latitudes in degrees into metres about the origin."""
        return (np.asarray(degrees, dtype=float) - self.origin) * self.scale

    def to_degrees(self, metres: Any) -> np.ndarray:
        """Convert (..., 2) metres about the origin into longitudes and latitudes in degrees."""
        return np.asarray(metres, dtype=float) / self.scale + self.origin

    def report_lines(self) -> list[str]:
        """Return one line for the size of the site and one for every step that changed something."""
        x_min, y_min, x_max, y_max = self.bounds
        lon, lat = self.origin
        head = f"site of {x_max - x_min:.0f} m x {y_max - y_min:.0f} m about longitude {lon:.5f}, latitude {lat:.5f}"
        return [head] + [f"{count} {REPORT[key]}" for key, count in self.report.items() if count or key == "buildings"]


def file_of(options: SiteOptions) -> Path:
    """Return the path of the GeoJSON file of a site."""
    return Path(__file__).with_name("plant.geojson") if options.file == "plant" else Path(options.file).expanduser()


def load_site(options: SiteOptions) -> Site:
    """Read the GeoJSON file and make a site from it.

    Longitude and latitude are linearised about the centre of the site, with the metres per degree of the WGS84
    ellipsoid at that place. Raises SiteError if the file, the coordinates or the bounds do not describe a site.
    """
    path = file_of(options)
    report = dict.fromkeys(REPORT, 0)
    outlines = read_outlines(path, report)
    rings = [ring for outline in outlines for ring in outline.rings]
    lower, upper = _limits_around(rings, path, options) if options.bounds is None else _limits_given(options.bounds)
    origin = (float(lower[0] + upper[0]) / 2, float(lower[1] + upper[1]) / 2)
    scale = metres_per_degree(origin[1])
    half = (upper - lower) / 2 * scale + (options.margin if options.bounds is None else 0.0)
    _check_sides(2 * half, path, options)
    x, y = round(float(half[0]), 3), round(float(half[1]), 3)

    footprints = [
        Footprint(polygon, outline.name, outline.kind)
        for outline in outlines
        for polygon in repair([(ring - origin) * scale for ring in outline.rings], report)
    ]
    report["footprints"] = len(footprints)
    room = box(options.rim - x, options.rim - y, x - options.rim, y - options.rim)
    kept = arrange(footprints, room, options.rim, options.narrowest_gap, report)
    if footprints and report["outside"] == len(footprints):
        raise SiteError(f"site file {path}: none of its {len(footprints)} footprints lies within the limits")
    covered = sum(footprint.polygon.area for footprint in kept) / room.area
    if covered > 1 - SMALLEST_OPEN_FRACTION:
        raise SiteError(f"site file {path}: no free room, buildings and what they enclose cover {covered:.0%} of it")
    return Site(
        bounds=(-x, -y, x, y),
        buildings=tuple(footprint.polygon for footprint in kept),
        names=tuple(footprint.name for footprint in kept),
        types=tuple(footprint.kind for footprint in kept),
        origin=origin,
        scale=scale,
        report=report,
    )


def _limits_around(rings: list[np.ndarray], path: Path, options: SiteOptions) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and the upper corner (2,), in degrees, of all rings (k, 2)."""
    corners = np.concatenate([np.empty((0, 2)), *rings])
    if not len(corners):
        raise SiteError(f"site file {path}: no building in it, expected at least one, or the option 'bounds'")
    if options.margin < options.rim:
        raise SiteError(f"site: the margin is {options.margin:g} m, expected at least the rim of {options.rim:g} m")
    return corners.min(axis=0), corners.max(axis=0)


def _limits_given(bounds: list[float]) -> tuple[np.ndarray, np.ndarray]:
    if len(bounds) != 4:
        raise SiteError(f"site: expected bounds [lon_min, lat_min, lon_max, lat_max], got {len(bounds)} numbers")
    west, south, east, north = bounds
    if not (-180 <= west < east <= 180 and -90 < south < north < 90):
        expected = "lon_min < lon_max within [-180, 180] and lat_min < lat_max within (-90, 90)"
        raise SiteError(f"site: expected bounds in degrees with {expected}, got {bounds}")
    return np.array([west, south]), np.array([east, north])


def _check_sides(sides: np.ndarray, path: Path, options: SiteOptions) -> None:
    if not options.rim >= options.narrowest_gap > 0:
        got = f"got a rim of {options.rim:g} m and a gap of {options.narrowest_gap:g} m"
        raise SiteError(f"site: expected a rim at least as wide as the narrowest gap, and that above 0, {got}")
    got = f"got {sides[0]:.6g} m x {sides[1]:.6g} m"
    if not max(sides) <= LONGEST_SIDE:
        expected = f"sides of at most {LONGEST_SIDE:.0f} m (are the coordinates longitude and latitude in degrees?)"
        raise SiteError(f"site file {path}: expected {expected}, {got}")
    smallest = 2 * options.rim + 2 * options.narrowest_gap
    if not min(sides) >= smallest:
        raise SiteError(f"site file {path}: expected sides of at least {smallest:g} m, two rims and two gaps, {got}")
