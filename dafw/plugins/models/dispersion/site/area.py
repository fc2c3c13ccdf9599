"""The rectangle in degrees whose buildings are asked for."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

from dafw.core.errors import ConfigurationError
from dafw.core.geography import metres_per_degree
from dafw.plugins.models.dispersion.site.site import LONGEST_SIDE

DECIMALS = 7
"""Of a degree: about a centimetre, as exact as the coordinates of OpenStreetMap are."""


@dataclass(frozen=True)
class Area:
    """A rectangle between two longitudes and two latitudes, in degrees."""

    west: float
    south: float
    east: float
    north: float

    def meets(self, bounds: tuple[float, float, float, float]) -> bool:
        """Return whether another rectangle (west, south, east, north) overlaps this one."""
        west, south, east, north = bounds
        return west <= self.east and east >= self.west and south <= self.north and north >= self.south

    def __str__(self) -> str:
        sides = (self.west, self.south, self.east, self.north)
        return ",".join(f"{side:.{DECIMALS}f}".rstrip("0").rstrip(".") for side in sides)


def area_between(text: str) -> Area:
    """Return the area that ``W,S,E,N`` means, in degrees; raises ConfigurationError."""
    west, south, east, north = _numbers(text, "--bbox", "W,S,E,N")
    if not (-180 <= west < east <= 180 and -90 < south < north < 90):
        raise ConfigurationError(
            f"site fetch: --bbox expects W,S,E,N in degrees with W < E within [-180, 180] and S < N within (-90, 90), "
            f"got {text}"
        )
    return _checked(Area(west, south, east, north), f"--bbox {text}")


def area_around(text: str) -> Area:
    """Return the square that ``LAT,LON,RADIUS`` means: its sides are RADIUS metres from the place.

    Raises ConfigurationError.
    """
    latitude, longitude, radius = _numbers(text, "--around", "LAT,LON,RADIUS")
    if not (abs(latitude) < 89 and abs(longitude) <= 180 and radius > 0):
        raise ConfigurationError(
            f"site fetch: --around expects LAT,LON,RADIUS with a latitude within (-89, 89), a longitude within "
            f"[-180, 180], both in degrees, and a radius above 0 in metres, got {text}"
        )
    east, north = (radius / metres for metres in metres_per_degree(latitude))
    sides = (longitude - east, latitude - north, longitude + east, latitude + north)
    return _checked(Area(*(round(side, DECIMALS) for side in sides)), f"--around {text}")


def _numbers(text: str, option: str, form: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != len(form.split(",")) or not all(map(isfinite, numbers)):
        raise ConfigurationError(f"site fetch: {option} expects {form} as numbers, got {text!r}")
    return numbers


def _checked(area: Area, asked: str) -> Area:
    """Return the area; raises ConfigurationError if a site cannot be so large, or crosses the date line."""
    if not -180 <= area.west < area.east <= 180:
        raise ConfigurationError(f"site fetch: {asked} crosses the date line, where no site can be")
    widest = min(abs(area.south), abs(area.north)) if area.south * area.north > 0 else 0.0
    width = (area.east - area.west) * metres_per_degree(widest)[0]
    height = (area.north - area.south) * metres_per_degree((area.south + area.north) / 2)[1]
    if max(width, height) > LONGEST_SIDE:
        raise ConfigurationError(
            f"site fetch: {asked} is {width / 1e3:.3g} km x {height / 1e3:.3g} km, expected sides of at most "
            f"{LONGEST_SIDE / 1e3:g} km"
        )
    return area
