"""Plugins that are right but for one thing, each caught by the check that is named after its key."""

# ruff: noqa: N803, N806  (R, the letter of the formulas)

from __future__ import annotations

import os
import random
import sys
from dataclasses import dataclass, replace

import numpy as np

from dafw import (
    NONNEGATIVE,
    Analysis,
    Filter,
    Model,
    ObservationOperator,
    Observer,
    Policy,
    Route,
    Selection,
    StateSpace,
    Step,
    Variable,
    option,
    whiten,
)
from dafw.plugins.filters.etkf import ETKF, transform

BROKEN: dict[tuple[str, str], type] = {}


def breaks(check: str):
    def register(cls: type) -> type:
        BROKEN[cls.kind, check] = cls
        return cls

    return register


# Filters: an ETKF with one fault. --------------------------------------------------------------------------------


class Moved(ETKF):
    """The ETKF, and something done to its members afterwards."""

    def move(self, members, forecast, observation):
        return members

    def analyse(self, forecast, predicted, observation, rng):
        right = super().analyse(forecast, predicted, observation, rng).members
        return Analysis(self.move(np.array(right), forecast, observation))


@breaks("shapes")
class TransposesWideOnes(ETKF):
    def analyse(self, forecast, predicted, observation, rng):
        right = super().analyse(forecast, predicted, observation, rng).members
        return Analysis(right.T if right.shape == (5, 12) else right)


@breaks("inputs_unchanged")
class WritesIntoItsMemory(ETKF):
    def initial_memory(self, n_members):
        return {"count": np.zeros(1)}

    def analyse_with_memory(self, forecast, predicted, observation, memory, rng):
        memory["count"][0] += 1.0
        return Analysis(self.analyse(forecast, predicted, observation, rng).members, memory)


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
class FirstMemberFirst(ETKF):
    """Mean and covariance are exact; which member gets which anomaly depends on its number."""

    def analyse(self, forecast, predicted, observation, rng):
        mean = predicted.mean(axis=0)
        weights, matrix = transform(predicted - mean, observation.values - mean, observation.covariance)
        # A cyclic shift of the anomalies keeps mean and covariance, wherever it puts whom.
        matrix = np.roll(matrix, 1, axis=0)
        return Analysis(forecast.space.retract(forecast.mean, (weights + matrix) @ forecast.anomalies))


@breaks("reading_order")
class TrustsTheFirstReading(ETKF):
    accuracy = "none"

    def analyse(self, forecast, predicted, observation, rng):
        R = observation.covariance
        trust = 1.0 + np.arange(len(R))
        mean = predicted.mean(axis=0)
        R = R * trust if R.ndim == 1 else R * np.sqrt(np.outer(trust, trust))
        weights, matrix = transform(predicted - mean, observation.values - mean, R)
        return Analysis(forecast.space.retract(forecast.mean, (weights + matrix) @ forecast.anomalies))


@breaks("prior_kept")
class AlwaysMoves(ETKF):
    """A fixed gain: what the readings are worth makes no difference."""

    accuracy = "none"

    def analyse(self, forecast, predicted, observation, rng):
        missed = (observation.values - predicted).mean(axis=1, keepdims=True)
        return Analysis(forecast.space.retract(forecast.members, 0.1 * missed * np.ones(forecast.space.size)))


@breaks("angle_seam")
class AveragesAngles(ETKF):
    """Takes the arithmetic mean of angles."""

    def analyse(self, forecast, predicted, observation, rng):
        mean, members = predicted.mean(axis=0), forecast.members
        weights, matrix = transform(predicted - mean, observation.values - mean, observation.covariance)
        centre = members.mean(axis=0)
        return Analysis(forecast.space.retract(centre, (weights + matrix) @ (members - centre)))


@breaks("stays_in_set")
class Unbounded(ETKF):
    def analyse(self, forecast, predicted, observation, rng):
        mean = predicted.mean(axis=0)
        weights, matrix = transform(predicted - mean, observation.values - mean, observation.covariance)
        return Analysis(forecast.mean + (weights + matrix) @ forecast.anomalies)


@breaks("infinite_radius")
@dataclass
class CappedRadius(ETKF):
    """Readings far from the origin are tapered; the radius is cut off at 100 m behind the user's back."""

    radius: float = option(1e3, "localization radius in metres", above=0.0)
    accuracy = "none"
    localization_option = "radius"

    def analyse(self, forecast, predicted, observation, rng):
        distance = np.linalg.norm(observation.operator.coordinates, axis=1)
        grown = np.exp((distance / min(self.radius, 100.0)) ** 2 / 4.0)
        R = observation.covariance
        R = R * grown if R.ndim == 1 else R * np.sqrt(np.outer(grown, grown))
        mean = predicted.mean(axis=0)
        weights, matrix = transform(predicted - mean, observation.values - mean, R)
        return Analysis(forecast.space.retract(forecast.mean, (weights + matrix) @ forecast.anomalies))


@breaks("restart")
class RemembersOnItself(Moved):
    calls = 0

    def move(self, members, forecast, observation):
        self.calls += 1
        return members if self.calls < 3 else members * (1.0 + 1e-12)


@breaks("kalman_exact")
class AlmostExact(Moved):
    def move(self, members, forecast, observation):
        # Forgets the (N - 1) of the covariance only where there are few members to notice.
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


# Models: a random walk that cannot go below zero, with one fault. ---------------------------------------------------


class Walk(Model):
    dt = 1.0

    def __init__(self):
        self.space = StateSpace([Variable("level", 4, NONNEGATIVE)])

    def initial(self, n_members, rng):
        return np.abs(rng.standard_normal((n_members, 4)))

    def step(self, members, t, rng):
        return np.abs(members + 0.1 * rng.standard_normal(members.shape))


@breaks("shapes")
class DropsTheFifth(Walk):
    def step(self, members, t, rng):
        return super().step(members, t, rng)[:4]


@breaks("inputs_unchanged")
class WritesIntoTheMemory(Walk):
    def initial_memory(self, members):
        return {"scratch": np.zeros(len(members))}

    def step_with_memory(self, members, memory, t, rng):
        memory["scratch"][:] = 7.0
        return Step(self.step(members, t, rng), {"scratch": np.zeros(len(members))})


@breaks("determinism")
class FreshEntropyAtFirst(Walk):
    def initial(self, n_members, rng):
        return super().initial(n_members, rng) + (np.random.default_rng().random() if n_members == 3 else 0.0)


@breaks("own_generator")
class PythonsGenerator(Walk):
    def step(self, members, t, rng):
        return super().step(members, t, rng) + 0.0 * random.random()


@breaks("larger_ensemble")
class DrawsByVariable(Walk):
    def initial(self, n_members, rng):
        return np.abs(rng[0].standard_normal((4, n_members)).T)


@breaks("batches")
class MembersMeet(Walk):
    def step(self, members, t, rng):
        return super().step(members, t, rng) + 1e-12 * members.mean(axis=0)


@breaks("restart")
class CountsItsSteps(Walk):
    steps = 0

    def step(self, members, t, rng):
        self.steps += 1
        return super().step(members, t, rng) * (1.0 + 1e-12 * (self.steps == 2) * (t > 0.0) * (len(members) == 3))


@breaks("first_guess_in_set")
class NegativeFirstGuess(Walk):
    def initial(self, n_members, rng):
        return rng.standard_normal((n_members, 4))


@breaks("steps_in_set")
class Undershoots(Walk):
    def step(self, members, t, rng):
        return super().step(members, t, rng) - 0.5


# Observers: the first and last entry of the concentration, with one fault. -----------------------------------------


class Ends(Observer):
    def operator(self, space, route, t):
        return Selection(indices=np.array([0, 11]), covariance=np.array([0.01, 0.01]))


def own(apply, R=(0.01, 0.01)):
    made = type("Made", (ObservationOperator,), {"apply": lambda self, members: apply(members)})
    return made(covariance=np.array(R))


@breaks("shapes")
class OneMemberLosesAnAxis(Ends):
    def operator(self, space, route, t):
        return own(lambda members: np.squeeze(members[:, [0, 11]]))


@breaks("covariances")
class NotDefinite(Ends):
    def operator(self, space, route, t):
        return own(lambda members: members[:, [0, 11]], [[1.0, 2.0], [2.0, 1.0]])


@breaks("inputs_unchanged")
class ClampsWhatItReads(Ends):
    def operator(self, space, route, t):
        def apply(members):
            if members.flags.writeable:
                members[:, 0] = 0.0
            return members[:, [1, 11]]

        return own(apply)


@breaks("determinism")
class NoiseOfItsOwn(Ends):
    def operator(self, space, route, t):
        return replace(super().operator(space, route, t), noise_covariance=np.random.default_rng().random(2))


@breaks("own_generator")
class AddsGlobalNoise(Ends):
    def operator(self, space, route, t):
        random.random()
        return super().operator(space, route, t)


@breaks("member_order")
class ReadsTheMean(Ends):
    def operator(self, space, route, t):
        return own(lambda members: members[:, [0, 11]] - 0.5 * members[:1, [0, 11]])


@breaks("restart")
class DriftsAsItReads(Ends):
    asked = 0

    def operator(self, space, route, t):
        self.asked += 1
        return own(lambda members, k=self.asked: members[:, [0, 11]] * (1.0 + 1e-9 * k))


# Policies: one step to the east where that is free, with one fault. ---------------------------------------------------


class East(Policy):
    def heading(self, belief, vehicle, rng):
        return 0.0

    def decide(self, belief, vehicle, rng):
        heading = self.heading(belief, vehicle, rng)
        step = vehicle.reach * np.array([np.cos(heading), np.sin(heading)])
        free = [vehicle.airspace is None or vehicle.airspace.is_free(p, p + step) for p in vehicle.positions]
        return Route(tuple(np.array([p, p + step if ok else p]) for p, ok in zip(vehicle.positions, free, strict=True)))


@breaks("shapes")
class NeedsAVehicle(East):
    def heading(self, belief, vehicle, rng):
        return 0.0 * vehicle.positions[0, 0]


@breaks("free_airspace")
class ThroughWalls(Policy):
    def decide(self, belief, vehicle, rng):
        step = np.array([vehicle.reach, 0.0])
        return Route(tuple(np.array([p, p + step]) for p in vehicle.positions))


@breaks("inputs_unchanged")
class WritesIntoThePolicysMemory(East):
    def initial_memory(self, vehicle):
        return {"count": np.zeros(1)}

    def decide_with_memory(self, belief, vehicle, memory, rng):
        memory["count"][0] += 1.0
        return Route(self.decide(belief, vehicle, rng).paths, memory)


@breaks("determinism")
class Whim(East):
    def heading(self, belief, vehicle, rng):
        return 1e-12 * np.random.default_rng().random()


@breaks("own_generator")
class Dice(East):
    def heading(self, belief, vehicle, rng):
        random.random()
        return 0.0


@breaks("member_order")
class FollowsTheFirstMember(East):
    def heading(self, belief, vehicle, rng):
        return float(belief.members[0, 0])


@breaks("restart")
class TurnsEachTime(East):
    turned = 0

    def heading(self, belief, vehicle, rng):
        self.turned += 1
        return 0.1 * self.turned


@breaks("truth_blind")
class Peeks(East):
    """Climbs the stack until it finds the truth."""

    def heading(self, belief, vehicle, rng):
        frame = sys._getframe()
        while frame is not None:
            state = frame.f_locals.get("state")
            if hasattr(state, "truth"):
                return float(state.truth.ensemble.members[0, 0])
            frame = frame.f_back
        return 0.0
