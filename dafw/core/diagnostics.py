"""Scores of a belief against the truth."""

from __future__ import annotations

import math

from dafw.core.space import Array


def relative_error(truth: Array, estimate: Array) -> float:
    """Return ERR = |truth - estimate|_2 / |truth|_2 in per cent; NaN where the truth vanishes.

    Both (n,). Gioia et al. (2024), Sec. IV-B, doi:10.1109/SDF63218.2024.10773899.
    """
    size = _norm(truth)
    return _norm(truth - estimate) / size * 100.0 if size > 0.0 else float("nan")


def root_mean_square(values: Array) -> float:
    """Return the root of the mean of the squares of ``values`` (n,)."""
    return _norm(values) / math.sqrt(values.size)


def _norm(values: Array) -> float:
    return math.sqrt(values @ values)
