"""Filters that weight their members: importance sampling with one fault each."""

from __future__ import annotations

import numpy as np

from broken.registry import breaks
from dafw import Analysis, Filter, whiten


class Weighing(Filter):
    """The members stay the same; the weight of each is multiplied by its likelihood."""

    def likelihood(self, predicted, observation):
        missed = whiten(observation.covariance, observation.values - predicted)
        return np.exp(-0.5 * ((missed**2).sum(axis=1) - (missed**2).sum(axis=1).min()))

    def before(self, forecast):
        return np.full(len(forecast), 1.0 / len(forecast)) if forecast.weights is None else forecast.weights

    def analyse(self, forecast, predicted, observation, rng):
        weights = self.before(forecast) * self.likelihood(predicted, observation)
        members = forecast.space.retract(forecast.members, np.zeros(forecast.space.size))
        return Analysis(members, weights=weights / weights.sum())


@breaks("prior_kept")
class ForgetsTheWeights(Weighing):
    accuracy = "none"

    def before(self, forecast):
        return np.full(len(forecast), 1.0 / len(forecast))


@breaks("kalman_statistical")
class BelievesTwice(Weighing):
    def likelihood(self, predicted, observation):
        return super().likelihood(predicted, observation) ** 2


@breaks("member_order")
class WeightsByNumber(Weighing):
    """The weight of a member depends on its number, except if the readings carry no information."""

    accuracy = "none"

    def likelihood(self, predicted, observation):
        return np.sort(super().likelihood(predicted, observation))


@breaks("restart")
class WeightsOnSelf(Weighing):
    accuracy = "none"
    kept = None

    def before(self, forecast):
        return super().before(forecast) if self.kept is None else self.kept

    def analyse(self, forecast, predicted, observation, rng):
        right = super().analyse(forecast, predicted, observation, rng)
        self.kept = right.weights + 1e-12  # what was handed out was rounded
        return right
