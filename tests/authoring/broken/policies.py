"""Policies that fly one step east if the way is free, with one fault each."""

from __future__ import annotations

import random
import sys

import numpy as np

from broken.registry import breaks
from dafw import Policy, Route


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
    """Searches the call stack until it finds the truth."""

    def heading(self, belief, vehicle, rng):
        frame = sys._getframe()
        while frame is not None:
            state = frame.f_locals.get("state")
            if hasattr(state, "truth"):
                return float(state.truth.ensemble.members[0, 0])
            frame = frame.f_back
        return 0.0


# Policies that look ahead. --------------------------------------------------------------------------------------------


class Ahead(East):
    """Looks ahead, but ignores the result and flies east."""

    looks_ahead = True

    def plan(self, outlook, rng):
        self.seen = outlook.ahead(2).states[-1].ensemble
        return self.decide(outlook.belief.ensemble, outlook.vehicle, rng)


@breaks("inputs_unchanged")
class PlansInTheBelief(Ahead):
    def plan(self, outlook, rng):
        outlook.belief.memory["drift"][:] = 0.0
        return super().plan(outlook, rng)


@breaks("truth_blind")
class PeeksAhead(Ahead):
    def plan(self, outlook, rng):
        self.outlook = outlook
        return super().plan(outlook, rng)

    def heading(self, belief, vehicle, rng):
        return Peeks.heading(self, belief, vehicle, rng)
