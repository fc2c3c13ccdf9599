"""Asking a filter for an analysis, whether it looks back or not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dafw.core.ensemble import Analysis, Ensemble, Forecast, Memory
from dafw.core.executors.serial import Serial
from dafw.core.interfaces import Filter, Model
from dafw.core.observation import Observation
from dafw.core.rerun import Rerun
from dafw.core.rng import MemberStreams, Streams
from dafw.core.space import Array, StateSpace
from dafw.core.window import PastCycle, Window


@dataclass
class Still(Model):
    """Nothing happens: a re-run ends where it began."""

    space: StateSpace
    dt: float = 1.0

    def step(self, members: Array, t: float, rng: MemberStreams) -> Array:
        """Return the members as they were."""
        return members


def ask(
    filter_: Filter,
    forecast: Ensemble,
    predicted: Array,
    observation: Observation,
    memory: Memory | None,
    rng: np.random.Generator,
) -> Analysis:
    """Return the analysis of a forecast, checked as in a study.

    A filter that looks back is handed a window of the one cycle, at whose beginning the members were the forecast's.
    """
    if filter_.window == 0:
        return filter_.update(forecast, predicted, observation, memory, rng)
    model = Still(forecast.space)
    before = Ensemble(forecast.members, forecast.space, forecast.time - model.dt, forecast.weights)
    cycles = (PastCycle(0, Forecast(before), observation),)
    rerun = Rerun(model, Serial(), Streams(0))
    return filter_.look_back(Window(cycles, Forecast(forecast), predicted, (), memory, rerun), rng)
