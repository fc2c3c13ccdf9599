"""Observers of the first and last entry of the concentration, with one fault each."""

# ruff: noqa: N803  (R, the letter of the formulas)

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np

from broken.registry import breaks
from dafw import Diagnostic, ObservationOperator, Observer, Selection


class Ends(Observer):
    def operator(self, space, route, t):
        return Selection(indices=np.array([0, 11]), covariance=np.array([0.01, 0.01]))


def own(apply, R=(0.01, 0.01)):
    made = type("Made", (ObservationOperator,), {"apply": lambda self, members: apply(members)})
    return made(covariance=np.array(R))


class OverTime(Ends):
    """Has smaller errors if the step is longer."""

    def operator(self, space, route, t):
        return replace(super().operator(space, route, t), covariance=np.full(2, 0.01 / route.dt))


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


@breaks("diagnostics")
class ReportsTheWholeWay(Ends):
    """A diagnostic with a number for each corner of the path: more if the vehicle flew than if it hovered."""

    def operator(self, space, route, t):
        way = np.concatenate([np.empty((0, 2)), *route.paths])
        return replace(super().operator(space, route, t), diagnostics={"x": Diagnostic(way[:, 0], ("corner",))})


@breaks("restart")
class ReportsHowOftenItWasAsked(Ends):
    asked = 0

    def operator(self, space, route, t):
        self.asked += 1
        return replace(super().operator(space, route, t), diagnostics={"asked": Diagnostic(self.asked)})
