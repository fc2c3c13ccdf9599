"""Fly along listed points, whatever is read: the same places at the same times in every run.

With it filters can be compared on the same readings, so that estimation and search are told apart.

In each cycle a vehicle flies on towards its next point, and around it to the one after, as far as it gets: its path has
the length speed * dt. The first leg leads from where the vehicle starts to the first point. After the last point it
flies to the first one again, or hovers. Legs are straight; one through a building is refused before the run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import dist
from typing import Any

import numpy as np

from dafw.core.ensemble import Ensemble, Memory, Route, Vehicle
from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Policy
from dafw.core.options import REQUIRED, option
from dafw.core.space import Array


def flown(position: Array, points: Array, upcoming: int, around: bool, reach: float) -> tuple[Array, int]:
    """Return the path (k, 2) that a vehicle flies, and the number of the point that comes next.

    Args:
        position: (2,) where it is, in m.
        points: (K, 2) of its route, in m.
        upcoming: number of the point that comes next; K: it has been at all of them.
        around: whether the first point follows the last; if so, they must not all be the same.
        reach: how far it flies, in m.
    """
    path, left = [position], reach
    while left > 0.0 and upcoming < len(points):
        target = points[upcoming]
        distance = dist(path[-1], target)
        if distance > left:
            path.append(path[-1] + (target - path[-1]) * (left / distance))
            break
        if distance > 0.0:
            path.append(target)
        left -= distance
        upcoming += 1
        if around and upcoming == len(points):
            upcoming = 0
    return np.array(path), upcoming


def _is_place(given: Any) -> bool:
    """Return whether something is a place [x, y]."""
    numbers = isinstance(given, list | tuple) and len(given) == 2
    return numbers and all(isinstance(x, int | float) and not isinstance(x, bool) and np.isfinite(x) for x in given)


@dataclass
class ListedRoute(Policy):
    """Flies a route that is known before: a baseline for policies, and the same readings for all filters."""

    points: Any = option(
        REQUIRED, "where to fly, [[x, y], ...] in metres, for all vehicles; or one such list for each vehicle"
    )
    repeat: bool = option(True, "after the last point to the first again, around and around; false: hover at the last")

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return a way around the building of the checks."""
        return {"points": [[175.0, -15.0], [280.0, 20.0], [280.0, 180.0], [200.0, 180.0]]}

    def __post_init__(self) -> None:
        given = self.points if isinstance(self.points, list | tuple) else []
        lists = [given] if all(map(_is_place, given)) else given
        for one in lists:
            if not (isinstance(one, list | tuple) and one and all(map(_is_place, one))):
                raise ConfigurationError(
                    f"{self.label}: points must be [[x, y], ...] in metres, or one such list for each vehicle, got "
                    f"{self.points}"
                )
        self._lists = [np.array(one, dtype=np.float64) for one in lists]

    def _of_vehicle(self, number: int) -> tuple[Array, bool]:
        """Return the points (K, 2) of a vehicle, and whether it flies around and around."""
        points = self._lists[number if len(self._lists) > 1 else 0]
        return points, self.repeat and bool((points != points[0]).any())

    def suit_vehicles(self, vehicle: Vehicle) -> None:
        """Raise ConfigurationError if there is no list for each vehicle, or a leg meets a building or the edge."""
        n_vehicles = len(vehicle.positions)
        if len(self._lists) not in (1, n_vehicles):
            raise ConfigurationError(
                f"{self.label}: points must be one list for all vehicles, or {n_vehicles}, one for each; got "
                f"{len(self._lists)} lists"
            )
        for number, position in enumerate(vehicle.positions):
            points, around = self._of_vehicle(number)
            for start, end in pairwise([position, *points, *(points[:1] if around else [])]):
                hindrance = vehicle.airspace.hindrance(start, end) if vehicle.airspace else None
                if hindrance is not None:
                    raise ConfigurationError(
                        f"{self.label}: the leg of vehicle {number} from {start.tolist()} to {end.tolist()} meets "
                        f"{hindrance}; give it points on the way around"
                    )

    def initial_memory(self, vehicle: Vehicle) -> Memory:
        """Return the number of the point that comes next for each vehicle (V,)."""
        return {"upcoming": np.zeros(len(vehicle.positions), dtype=np.int64)}

    def decide_with_memory(
        self, belief: Ensemble, vehicle: Vehicle, memory: Memory | None, rng: np.random.Generator
    ) -> Route:
        """Return the next piece of each vehicle's route."""
        upcoming = (memory or self.initial_memory(vehicle))["upcoming"].copy()
        paths, notes = [], []
        for number, position in enumerate(vehicle.positions):
            points, around = self._of_vehicle(number)
            path, then = flown(position, points, int(upcoming[number]), around, vehicle.reach)
            # The legs of the route are free: only one from where a vehicle was not sent can meet anything.
            if vehicle.airspace is None or all(vehicle.airspace.is_free(*leg) for leg in pairwise(path)):
                upcoming[number] = then
            else:
                path = position[np.newaxis]
                notes.append(
                    f"vehicle {number} hovers at {position.round(1).tolist()}: its way to the route is blocked"
                )
            paths.append(path)
        return Route(tuple(paths), memory={"upcoming": upcoming}, notes=tuple(notes))
