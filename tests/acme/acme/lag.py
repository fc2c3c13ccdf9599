"""A fixed-lag smoother: the readings of now also change the beliefs of the last few cycles, by the same regression."""

from dataclasses import dataclass

import numpy as np

from dafw import Analysis, Filter, option, whiten


@dataclass
class Lag(Filter):
    """The stochastic EnKF with a memory of a few cycles."""

    window: int | None = option(5, "cycles that a reading reaches back", minimum=1)

    def analyse_window(self, window, rng):
        """Return the analysis of now and the beliefs of the window, all moved by the readings."""
        seen = whiten(window.observation.covariance, window.predicted - window.predicted.mean(axis=0))
        missed = whiten(window.observation.covariance, window.observation.values - window.predicted)
        missed = missed + rng.standard_normal(seen.shape)
        gain = np.linalg.solve(seen.T @ seen + (len(seen) - 1) * np.eye(seen.shape[1]), seen.T)

        def moved(ensemble):
            return ensemble.space.retract(ensemble.members, missed @ gain @ ensemble.anomalies)

        past = {cycle.number: cycle.belief.with_members(moved(cycle.belief.ensemble)) for cycle in window.cycles}
        return Analysis(moved(window.forecast.ensemble), window.memory, revised=past)
