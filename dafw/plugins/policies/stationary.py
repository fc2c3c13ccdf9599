"""Every vehicle hovers where it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dafw.core.ensemble import Ensemble, Route, Vehicle
from dafw.core.interfaces import Policy


@dataclass
class Stationary(Policy):
    """The policy of a study without vehicles; with vehicles it is the baseline for other policies."""

    def decide(self, belief: Ensemble, vehicle: Vehicle, rng: np.random.Generator) -> Route:
        """Return the route on which no vehicle moves."""
        return Route.hover(vehicle)
