"""Fixed stations: each reads its nearest node, in every step or at a fixed interval."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dafw.core.ensemble import Route
from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Observer
from dafw.core.observation import ObservationOperator
from dafw.core.options import REQUIRED, option
from dafw.core.space import StateSpace
from dafw.plugins.observers.nodes import read_nodes
from dafw.plugins.observers.schedule import is_due, require_steps


@dataclass
class Stations(Observer):
    """Sensors at fixed positions."""

    positions: list[list[float]] = option(REQUIRED, "positions of the stations, [[x, y], ...] in metres")
    every: float = option(1.0, "seconds between readings, the first at the end of the first step", above=0.0)
    variable: str = option("concentration", "state variable that is read; it needs coordinates")
    noise_sd: float = option(1e-3, "standard deviation of the readings' noise", above=0.0)
    assumed_variance: float | None = option(None, "error variance for the filter; null: noise_sd squared", above=0.0)

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return two stations that read at every other whole second."""
        return {"positions": [[10.0, 10.0], [290.0, 150.0]], "every": 2.0}

    def __post_init__(self) -> None:
        if any(len(position) != 2 for position in self.positions):
            raise ConfigurationError(f"observer 'stations': positions must be [[x, y], ...], got {self.positions}")

    def suit(self, space: StateSpace, dt: float) -> None:
        """Check the variable's coordinates, the stations' places and ``every``; raises ConfigurationError."""
        require_steps(self.every, dt, self.label)
        nodes = self.require_places(space, self.variable)
        if not self.positions:
            raise ConfigurationError(f"{self.label}: positions must name at least one place")
        lowest, highest = nodes.min(axis=0), nodes.max(axis=0)
        for position in self.positions:
            if np.any(position < lowest) or np.any(position > highest):
                raise ConfigurationError(f"{self.label}: the station at {position} lies outside the domain")

    def operator(self, space: StateSpace, route: Route, t: float) -> ObservationOperator:
        """Return the readings due in this step: all stations, or none."""
        due = is_due(t, self.every, route.dt)
        points = np.array(self.positions, dtype=np.float64).reshape(-1, 2) if due else np.empty((0, 2))
        sensors = [f"station {number}" for number in range(len(points))]
        return read_nodes(space, self.variable, points, sensors, self.noise_sd, self.assumed_variance)
