"""Nudging: a fixed fraction of the innovations changes the state, by the ensemble's regression."""

from dataclasses import dataclass

import numpy as np

from dafw import Analysis, Filter, option


@dataclass
class Nudging(Filter):
    """Its only option is that fraction."""

    accuracy = "none"
    expected_failures = {"prior_kept": "nudging does not ask how good the readings are"}  # noqa: RUF012  (as plainly as authors write)

    strength: float = option(0.3, "share of the misfit that is taken away", minimum=0.0, maximum=1.0)

    def analyse(self, forecast, predicted, observation, rng):
        """Return the members moved by the regression of the state on the predicted readings."""
        seen = predicted - predicted.mean(axis=0)
        regression = np.linalg.lstsq(seen, forecast.anomalies, rcond=1e-8)[0]
        missed = self.strength * (observation.values - predicted)
        return Analysis(forecast.space.retract(forecast.members, missed @ regression))
