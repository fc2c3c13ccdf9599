"""Scores of a belief: against the truth where there is one, and against its readings."""

from __future__ import annotations

import math

import numpy as np

from dafw.core.ensemble import Ensemble
from dafw.core.observation import Observation
from dafw.core.space import POSITIVE, Array, StateSpace

SCORES = ("err", "err_forecast", "err_free", "rmse", "spread")
INNOVATION = ("innovation_mean", "innovation_rms")


def relative_error(difference: float, truth: float) -> float:
    """Return ERR = |difference|_2 / |truth|_2 in per cent; NaN where the truth vanishes or a number is missing.

    Both are norms. Gioia et al. (2024), Sec. IV-B, doi:10.1109/SDF63218.2024.10773899.
    """
    return difference / truth * 100.0 if truth > 0.0 else math.nan


def root_mean_square(values: Array) -> float:
    """Return the root of the mean of the squares of ``values`` (n,)."""
    return _norm(values) / math.sqrt(values.size)


def error_of(space: StateSpace, truth: Array, estimate: Array) -> float:
    """Return ERR of the first variable of the state (per cent); both (n,). Angles are compared the short way round.

    Positive numbers are compared as they are: a difference of logarithms has not the units of the truth.
    """
    scored = space.variables[0]
    part, difference = space.slice(scored.name), np.subtract if scored.kind is POSITIVE else space.difference
    return relative_error(_norm(difference(truth, estimate)[part]), _norm(truth[part]))


def scores(
    space: StateSpace, truth: Array | None, belief: Ensemble, forecast: Ensemble | None, free: Ensemble | None
) -> dict[str, float]:
    """Return ``SCORES`` of the first variable of the state; NaN for what is missing. ``truth`` is (n,).

    ``rmse`` and ``spread`` of a positive variable are those of its logarithm, ERR is of its numbers as they are.
    """
    scored = space.variables[0]
    part, is_positive = space.slice(scored.name), scored.kind is POSITIVE
    found = dict.fromkeys(SCORES, math.nan)
    found["spread"] = root_mean_square(belief.spread[part])
    if truth is None:
        return found
    difference = np.subtract if is_positive else space.difference
    size, off = _norm(truth[part]), _norm(difference(truth, belief.mean)[part])
    found["err"] = relative_error(off, size)
    if is_positive:
        off = _norm(space.difference(truth, belief.mean)[part])
    found["rmse"] = off / math.sqrt(part.stop - part.start)
    if forecast is not None:
        found["err_forecast"] = relative_error(_norm(difference(truth, forecast.mean)[part]), size)
    if free is not None:
        found["err_free"] = relative_error(_norm(difference(truth, free.members[0])[part]), size)
    return found


def predicted_spread(forecast: Ensemble, predicted: Array, mean: Array) -> Array:
    """Return the standard deviation (m,) of the members' predictions (N, m), without the errors of the readings.

    ``mean`` (m,) is the mean of ``predicted``. As in every spread, N - 1 takes the place of N, or what weights leave.
    """
    off = predicted - mean
    if forecast.weights is None:
        return np.asarray(np.sqrt(np.einsum("ij,ij->j", off, off) / max(1, len(forecast) - 1)))
    share = max(1e-12, 1.0 - 1.0 / forecast.effective_size)
    return np.asarray(np.sqrt(np.einsum("i,ij,ij->j", forecast.weights, off, off) / share))


def innovation_scores(observation: Observation, mean: Array, spread: Array) -> dict[str, float]:
    """Return ``INNOVATION``: mean and root mean square of the normalised innovations; NaN without readings.

    An innovation y - mean(H x) is divided by the standard deviation that the forecast expects it to have, the root of
    its predicted variance plus that of R. ``mean`` and ``spread`` (m,) are those of the predictions. If the spread of
    the belief matches its error, the mean is near 0 and the root mean square near 1.
    """
    if observation.values.size == 0:
        return dict.fromkeys(INNOVATION, math.nan)
    normalised = (observation.values - mean) / np.sqrt(spread**2 + observation.variance)
    return {
        "innovation_mean": float(np.add.reduce(normalised)) / normalised.size,
        "innovation_rms": root_mean_square(normalised),
    }


def _norm(values: Array) -> float:
    # ``dot`` takes half the time of ``@`` for so few numbers; a row of a run file has six norms.
    return math.sqrt(values.dot(values))
