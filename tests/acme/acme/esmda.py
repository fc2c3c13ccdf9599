"""Ensemble smoother with multiple data assimilation, doi:10.1016/j.cageo.2012.03.011: runs the model from the start."""

from dataclasses import dataclass

import numpy as np

from dafw import Analysis, Filter, option, whiten


@dataclass
class ESMDA(Filter):
    """Updates the first guess with all readings so far, in several small steps, each with runs of the model."""

    past_beliefs = "first"

    window: int | None = option(None, "cycles to look back; null: to the start", minimum=1)
    iterations: int = option(4, "small steps of an analysis", minimum=1)
    every: int = option(1, "cycles from one analysis to the next", minimum=1)

    def analyse_window(self, window, rng):
        """Return the updated first guess, run to the present."""
        if (window.cycles[-1].number + 1) % self.every:
            return Analysis(window.forecast.ensemble.members, window.memory)
        guess, alpha = window.first.ensemble, self.iterations
        for _ in range(self.iterations):
            predicted = window.replay(guess).stacked()
            seen = whiten(window.covariance, predicted - predicted.mean(axis=0)) / np.sqrt(alpha)
            missed = whiten(window.covariance, window.values - predicted) / np.sqrt(alpha)
            missed = missed + rng.standard_normal(missed.shape)
            weights = np.linalg.solve(seen @ seen.T + (len(seen) - 1) * np.eye(len(seen)), guess.anomalies)
            guess = guess.with_members(guess.space.retract(guess.members, missed @ seen.T @ weights))
            guess = window.rerun.settled(guess)  # for example the cloud of a release that was moved
        now = window.replay(guess).forecast
        return Analysis(now.ensemble.members, window.memory, model_memory=now.memory)
