"""Sources of readings: noisy sensors with one fault each."""

from __future__ import annotations

import random
from dataclasses import dataclass

import numpy as np

from broken.registry import breaks
from dafw import Observation, ObservationOperator, Readings, Selection, Taken

FIRST = Selection(indices=np.array([0]), covariance=np.array([0.01]))


class Sensor(Readings):
    """Returns a value of about 1 at the end of every cycle."""

    operator = FIRST

    def value(self, request, rng):
        return 1.0 + 0.1 * rng.standard_normal()

    def take(self, request, rng):
        return [Observation(np.array([self.value(request, rng)]), self.operator, request.end)]


@dataclass(frozen=True, eq=False, kw_only=True)
class Squeezed(ObservationOperator):
    def apply(self, members):
        return np.squeeze(members[:, :1])


@breaks("shapes")
class OneMemberLosesAnAxis(Sensor):
    operator = Squeezed(covariance=np.array([0.01]))


@breaks("shapes")
class FailsNowAndThen(Sensor):
    def value(self, request, rng):
        return np.nan if rng.random() > 0.9 else 1.0


@breaks("shapes")
class AheadOfItsTime(Sensor):
    def take(self, request, rng):
        return [Observation(np.array([1.0]), FIRST, request.end + (rng.random() > 0.9))]


@breaks("inputs_unchanged")
class WritesIntoTheSourcesMemory(Sensor):
    def initial_memory(self):
        return {"count": np.zeros(1)}

    def take_with_memory(self, request, memory, rng):
        memory["count"] += 1.0
        return Taken(self.take(request, rng), {"count": np.zeros(1)})


@breaks("determinism")
class Whim(Sensor):
    def value(self, request, rng):
        return np.random.default_rng().random()


@breaks("own_generator")
class Dice(Sensor):
    def value(self, request, rng):
        return super().value(request, rng) + 0.0 * random.random()


@breaks("restart")
class Ages(Sensor):
    asked = 0

    def value(self, request, rng):
        self.asked += 1
        return super().value(request, rng) + 1e-12 * self.asked


@breaks("without_truth")
class LooksWhereItCan(Sensor):
    """Uses the truth without declaring ``needs_truth``."""

    def value(self, request, rng):
        return super().value(request, rng) if request.truth is None else request.truth.members[0, 0]
