"""Scores of a belief against the truth."""

from __future__ import annotations

import math

from dafw.core.ensemble import Ensemble
from dafw.core.space import Array, StateSpace

SCORES = ("err", "err_forecast", "err_free", "rmse", "spread")


def relative_error(truth: Array, estimate: Array) -> float:
    """Return ERR = |truth - estimate|_2 / |truth|_2 in per cent; NaN where the truth vanishes.

    Both (n,). Gioia et al. (2024), Sec. IV-B, doi:10.1109/SDF63218.2024.10773899.
    """
    size = _norm(truth)
    return _norm(truth - estimate) / size * 100.0 if size > 0.0 else float("nan")


def root_mean_square(values: Array) -> float:
    """Return the root of the mean of the squares of ``values`` (n,)."""
    return _norm(values) / math.sqrt(values.size)


def scores(
    space: StateSpace, truth: Array, belief: Ensemble, forecast: Ensemble | None, free: Ensemble | None
) -> dict[str, float]:
    """Return ``SCORES`` of the first variable of the state; NaN for what is missing. ``truth`` is (n,)."""
    part = space.slice(space.variables[0].name)
    return {
        "err": relative_error(truth[part], belief.mean[part]),
        "err_forecast": relative_error(truth[part], forecast.mean[part]) if forecast else float("nan"),
        "err_free": relative_error(truth[part], free.members[0, part]) if free else float("nan"),
        "rmse": root_mean_square(space.difference(belief.mean, truth)[part]),
        "spread": root_mean_square(belief.spread[part]),
    }


def _norm(values: Array) -> float:
    return math.sqrt(values @ values)
