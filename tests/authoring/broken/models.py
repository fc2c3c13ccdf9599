"""Models: random walks that cannot go below zero, with one fault each."""

from __future__ import annotations

import random

import numpy as np

from broken.registry import breaks
from dafw import NONNEGATIVE, Model, StateSpace, Step, Variable


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


@breaks("first_guess_possible")
class CallsItsZerosImpossible(Walk):
    def initial(self, n_members, rng):
        return np.maximum(rng.standard_normal((n_members, 4)), 0.0)

    def log_first_guess(self, members):
        return np.where((members > 0.0).all(axis=1), -0.5 * (members**2).sum(axis=1), -np.inf)


@breaks("steps_in_set")
class Undershoots(Walk):
    def step(self, members, t, rng):
        return super().step(members, t, rng) - 0.5


@breaks("several_steps")
class UsesTheSameNoiseTwice(Walk):
    def steps_with_memory(self, members, memory, t, rng, n_steps):
        steps = []
        for _ in range(min(n_steps, 2)):
            members = self.step(members, t, rng)
            steps.append(Step(members))
        return steps
