"""Filters: square-root filters with one fault each."""

# ruff: noqa: N806  (R, the letter of the formulas)

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from broken.registry import breaks
from dafw import Analysis, Filter, option, whiten
from dafw.plugins.filters.etkf import transform


class Square(Filter):
    """The ETKF without options."""

    accuracy = "exact"

    def analyse(self, forecast, predicted, observation, rng):
        return Analysis(square_root(forecast, predicted, observation.values, observation.covariance))


def square_root(forecast, predicted, values, covariance):
    """Return the members of the ETKF."""
    mean = predicted.mean(axis=0)
    weights, matrix = transform(predicted - mean, values - mean, covariance)
    return forecast.space.retract(forecast.mean, (weights + matrix) @ forecast.anomalies)


class Moved(Square):
    """The ETKF, with a change of its members afterwards."""

    def move(self, members, forecast, observation):
        return members

    def analyse(self, forecast, predicted, observation, rng):
        right = super().analyse(forecast, predicted, observation, rng).members
        return Analysis(self.move(np.array(right), forecast, observation))


@breaks("shapes")
class TransposesWideOnes(Square):
    def analyse(self, forecast, predicted, observation, rng):
        right = super().analyse(forecast, predicted, observation, rng).members
        return Analysis(right.T if right.shape == (5, 12) else right)


@breaks("inputs_unchanged")
class WritesIntoItsMemory(Square):
    def initial_memory(self, n_members):
        return {"count": np.zeros(1)}

    def analyse_with_memory(self, forecast, predicted, observation, memory, rng):
        memory["count"][0] += 1.0
        return Analysis(self.analyse(forecast, predicted, observation, rng).members, {"count": np.zeros(1)})


@breaks("determinism")
class FreshEntropy(Moved):
    def move(self, members, forecast, observation):
        return members + (1e-14 * int.from_bytes(os.urandom(1)) if observation.values.size == 1 else 0.0)


@breaks("own_generator")
class GlobalGenerator(Moved):
    def move(self, members, forecast, observation):
        return members + 0.0 * np.random.standard_normal()  # noqa: NPY002  (what is wrong with it)


@breaks("told_covariance")
class PeeksAtTheNoise(Moved):
    def move(self, members, forecast, observation):
        return members + 1e-3 * np.any(observation.operator.noise != observation.covariance)


@breaks("member_order")
class FirstMemberFirst(Square):
    """Mean and covariance are exact; which member gets which anomaly depends on its number."""

    def analyse(self, forecast, predicted, observation, rng):
        mean = predicted.mean(axis=0)
        weights, matrix = transform(predicted - mean, observation.values - mean, observation.covariance)
        # A cyclic shift of the anomalies keeps mean and covariance.
        matrix = np.roll(matrix, 1, axis=0)
        return Analysis(forecast.space.retract(forecast.mean, (weights + matrix) @ forecast.anomalies))


@breaks("reading_order")
class TrustsTheFirstReading(Square):
    accuracy = "none"

    def analyse(self, forecast, predicted, observation, rng):
        R = observation.covariance
        trust = 1.0 + np.arange(len(R))
        R = R * trust if R.ndim == 1 else R * np.sqrt(np.outer(trust, trust))
        return Analysis(square_root(forecast, predicted, observation.values, R))


@breaks("prior_kept")
class AlwaysMoves(Square):
    """A fixed gain, which does not depend on the readings' errors."""

    accuracy = "none"

    def analyse(self, forecast, predicted, observation, rng):
        missed = (observation.values - predicted).mean(axis=1, keepdims=True)
        return Analysis(forecast.space.retract(forecast.members, 0.1 * missed * np.ones(forecast.space.size)))


@breaks("angle_seam")
class AveragesAngles(Square):
    """Takes the arithmetic mean of angles."""

    def analyse(self, forecast, predicted, observation, rng):
        mean, members = predicted.mean(axis=0), forecast.members
        weights, matrix = transform(predicted - mean, observation.values - mean, observation.covariance)
        centre = members.mean(axis=0)
        return Analysis(forecast.space.retract(centre, (weights + matrix) @ (members - centre)))


@breaks("stays_in_set")
class Unbounded(Square):
    def analyse(self, forecast, predicted, observation, rng):
        mean = predicted.mean(axis=0)
        weights, matrix = transform(predicted - mean, observation.values - mean, observation.covariance)
        return Analysis(forecast.mean + (weights + matrix) @ forecast.anomalies)


@breaks("infinite_radius")
@dataclass
class CappedRadius(Square):
    """Readings far from the origin are tapered; the radius is limited to 100 m without telling the user."""

    radius: float = option(1e3, "localization radius in metres", above=0.0)
    accuracy = "none"
    localization_option = "radius"

    def analyse(self, forecast, predicted, observation, rng):
        distance = np.linalg.norm(observation.operator.coordinates, axis=1)
        grown = np.exp((distance / min(self.radius, 100.0)) ** 2 / 4.0)
        R = observation.covariance
        R = R * grown if R.ndim == 1 else R * np.sqrt(np.outer(grown, grown))
        return Analysis(square_root(forecast, predicted, observation.values, R))


@breaks("restart")
class RemembersOnItself(Moved):
    calls = 0

    def move(self, members, forecast, observation):
        self.calls += 1
        return members if self.calls < 3 else members * (1.0 + 1e-12)


@breaks("kalman_exact")
class AlmostExact(Moved):
    def move(self, members, forecast, observation):
        # Forgets the (N - 1) of the covariance only if there are few members.
        mean = members.mean(axis=0)
        return mean + (members - mean) * (1.0 + 1e-6) if forecast.space.size == 8 else members


@breaks("kalman_statistical")
class NoPerturbations(Filter):
    """An EnKF that forgets to perturb the observations: the members come too close together."""

    def analyse(self, forecast, predicted, observation, rng):
        seen = whiten(observation.covariance, predicted - predicted.mean(axis=0))
        missed = whiten(observation.covariance, observation.values - predicted)
        gain = np.linalg.solve(seen.T @ seen + (len(seen) - 1) * np.eye(seen.shape[1]), seen.T @ forecast.anomalies)
        return Analysis(forecast.space.retract(forecast.members, missed @ gain))


@breaks("inflation")
@dataclass
class InflatesTheGainAlone(Filter):
    """An EnKF that inflates the anomalies in the gain, but not the members."""

    inflation: float = option(1.0, "factor on the forecast anomalies", minimum=1.0)

    def analyse(self, forecast, predicted, observation, rng):
        seen = self.inflation * whiten(observation.covariance, predicted - predicted.mean(axis=0))
        missed = whiten(observation.covariance, observation.values - predicted) + rng.standard_normal(seen.shape)
        gain = np.linalg.solve(seen.T @ seen + (len(seen) - 1) * np.eye(seen.shape[1]), seen.T @ forecast.anomalies)
        return Analysis(forecast.space.retract(forecast.members, self.inflation * missed @ gain))


# Right at the first analysis, and wrong later. ------------------------------------------------------------------------


class LaterOnSelf(Square):
    """Adds 100 to the first member from the second analysis on: it keeps a counter on itself."""

    calls = 0

    def analyse(self, forecast, predicted, observation, rng):
        self.calls += 1
        members = np.array(super().analyse(forecast, predicted, observation, rng).members)
        members[0] += 100.0 * (self.calls > 1)
        return Analysis(members)


class LaterByMemory(Square):
    """Adds 100 to the first member from the second analysis on: it keeps a counter in its memory."""

    def initial_memory(self, n_members):
        return {"calls": np.array(0)}

    def analyse_with_memory(self, forecast, predicted, observation, memory, rng):
        calls = int(memory["calls"]) + 1
        members = np.array(self.analyse(forecast, predicted, observation, rng).members)
        members[0] += 100.0 * (calls > 1)
        return Analysis(members, {"calls": np.array(calls)})
