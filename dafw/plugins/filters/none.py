"""No assimilation: the analysis is the forecast, so the ensemble evolves by the model alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dafw.core.ensemble import Analysis, Ensemble
from dafw.core.interfaces import Filter
from dafw.core.observation import Observation
from dafw.core.space import Array


@dataclass
class NoFilter(Filter):
    """Leaves the belief as the model made it; works with a single member."""

    smallest_ensemble = 1
    accuracy = "none"

    def analyse(
        self, forecast: Ensemble, predicted: Array, observation: Observation, rng: np.random.Generator
    ) -> Analysis:
        """Return the forecast's members, moved into the range of each variable as every filter does."""
        return Analysis(forecast.space.retract(forecast.members, np.zeros(forecast.space.size)))
