"""Where release and drones of a study can be on a site, and the command that puts them there."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from shapely.ops import nearest_points

from dafw.core.composition import quoted_override
from dafw.core.errors import SiteError
from dafw.plugins.models.dispersion.site.site import Site

DIGITS = 1
"""Digits after the point of a place in metres."""
DRONE_CLEARANCE = 5.0
"""Metres from walls that are looked for when a drone's place is suggested."""

Point = tuple[float, float]


@dataclass(frozen=True)
class Places:
    """The release and the start of every drone, in metres about the centre of the site."""

    release: Point
    drones: tuple[Point, ...] = ()


class Ground:
    """The free ground of a site.

    >>> from dafw.plugins.models.dispersion.site.options import SiteOptions
    >>> from dafw.plugins.models.dispersion.site.site import load_site
    >>> Ground(load_site(SiteOptions())).problem((1000.0, 0.0))
    'is outside of the site'
    """

    def __init__(self, site: Site) -> None:
        self.site = site
        self._limits = shapely.box(*site.bounds)

    def problem(self, place: Point) -> str:
        """Return why nothing can be at a place, in words that go on a sentence; empty if it is free."""
        point = shapely.Point(place)
        if not self._limits.covers(point):
            return "is outside of the site"
        for building, name in zip(self.site.buildings, self.site.names, strict=True):
            if building.intersects(point):
                return f"is in {shortened(name)!r}"
        return ""

    def clearance(self, place: Point) -> float:
        """Return the distance in m to the nearest wall; infinite without buildings."""
        walls = [building.distance(shapely.Point(place)) for building in self.site.buildings]
        return min(walls, default=float("inf"))

    def free_near(self, place: Point, clearance: float) -> Point:
        """Return the place itself if it is free, else one near it that is: if possible so far from walls (m).

        Where no place is so far from all walls, half of it is tried, and so on. Raises SiteError if none is free.
        """
        if not self.problem(place):
            return place
        point = shapely.Point(place)
        while clearance > 0.05:
            room = self.site.domain.buffer(-clearance)
            if not room.is_empty:
                found = nearest_points(room, point)[0]
                rounded = (round(found.x, DIGITS), round(found.y, DIGITS))
                if not self.problem(rounded):
                    return rounded
            clearance /= 2.0
        raise SiteError("site preview: there is no free ground between the buildings where anything could be placed")


def shortened(name: str, longest: int = 60) -> str:
    """Return the name of a building for a line: buildings that were joined can have very long ones."""
    return name if len(name) <= longest else f"{name[: longest - 3]}..."


def command_of(file: str, overrides: Sequence[str], composed: Mapping[str, Any], places: Places) -> str:
    """Return the command, quoted for a shell, that runs a study with its release and drones at some places.

    Args:
        file: of the site, as ``model.site.file`` takes it.
        overrides: of the study, as ``dafw run`` takes them.
        composed: the configuration that they make.
        places: of release and drones.
    """
    set_here = {"model.site.file": quoted_override("model.site.file", file), **_settings(composed, places)}
    if composed.get("section") and file != "plant" and not any(_key(word) == "section" for word in overrides):
        set_here["section"] = "section=[]"  # that of the study is drawn for another site
    given = [word for word in overrides if _key(word) not in set_here]
    return " ".join(map(shell_quoted, ["dafw", "run", *given, *set_here.values()]))


def shell_quoted(word: str) -> str:
    """Return a word as a shell takes it.

    >>> print(shell_quoted("file='my site.geojson'"), shell_quoted("release=[1,2]"), shell_quoted("seed=1"))
    "file='my site.geojson'" 'release=[1,2]' seed=1
    """
    if "'" in word and not re.search(r'["$`\\!]', word):
        return f'"{word}"'  # shlex would escape every single quote
    return shlex.quote(word)


def _settings(composed: Mapping[str, Any], places: Places) -> dict[str, str]:
    """Return the overrides, by their key, that put release and drones at some places."""
    x, y = (_number(value) for value in places.release)
    found = {"model.release": f"model.release=[{x},{y}]"}
    for role in ("truth", "free"):
        if "release" in (composed.get(role) or {}):
            found[f"{role}.release"] = f"{role}.release=[{x},{y}]"
    priors = composed["model"].get("priors") or {}
    for axis, value in (("x", x), ("y", y)):
        if "mean" in (priors.get(f"release_{axis}") or {}):
            key = f"model.priors.release_{axis}.mean"
            found[key] = f"{key}={value}"
    if places.drones:
        starts = ",".join(f"[{_number(x)},{_number(y)}]" for x, y in places.drones)
        found["vehicle.start"] = f"vehicle.start=[{starts}]"
    return found


def _number(value: float) -> str:
    return repr(float(np.round(value, DIGITS)) + 0.0)  # no negative zero


def _key(word: str) -> str:
    found = re.match(r"\+{0,2}([\w.@/-]+)=", word)
    return found[1] if found else ""
