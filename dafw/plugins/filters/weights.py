"""Weights of samples: how degenerate they are, and drawing by them."""

from __future__ import annotations

import numpy as np

from dafw.core.errors import ComputationError
from dafw.core.space import Array, IntArray


def normalized(log_weights: Array) -> Array:
    """Return weights (P,) that add up to one; equal ones if all are minus infinity.

    Raises ComputationError for NaN and +infinity, of which no weights can be made.
    """
    if wrong := np.count_nonzero(~(log_weights < np.inf)):
        raise ComputationError(f"weights of samples: {wrong} of {len(log_weights)} log weights are NaN or infinity")
    largest = log_weights.max()
    if largest == -np.inf:
        return np.full(len(log_weights), 1.0 / len(log_weights))
    weights = np.exp(log_weights - largest)
    return np.asarray(weights / weights.sum())


def effective_size(weights: Array) -> float:
    """Return 1 / sum w^2."""
    return float(1.0 / (weights @ weights))


def n_moments(k: int) -> int:
    """Return how many numbers the moments of a density of k numbers are: its integral, mean and covariance."""
    return (k + 1) * (k + 2) // 2


def clipped(log_weights: Array, count: int) -> Array:
    """Return weights (P,) of which the ``count`` largest are made equal to the smallest of these.

    Koblents and Miguez (2015), doi:10.1007/s11222-013-9440-2.
    """
    return normalized(np.minimum(log_weights, np.partition(log_weights, -count)[-count]))


def systematic(weights: Array, size: int, offset: float) -> IntArray:
    """Return ``size`` indices drawn from the weights by systematic resampling: each within one of its expected count.

    ``offset`` is a uniform draw from [0, 1). With the same offset and slightly different weights most of the indices
    are the same. Kitagawa (1996), doi:10.1080/10618600.1996.10474692.
    """
    positions = (offset + np.arange(size)) / size
    return np.minimum(np.searchsorted(np.cumsum(weights), positions), len(weights) - 1)


def without_repeats(shares: Array, size: int, offset: float) -> tuple[IntArray, Array]:
    """Return ``size`` different indices in ascending order, and the chance (size,) that each had of being drawn.

    The chance of an index is min(1, c share), with c such that the chances add up to ``size``. A weight divided by
    the chance therefore keeps the expectation of every average (Horvitz and Thompson 1952,
    doi:10.1080/01621459.1952.10483446). Returns all if there are not more than ``size``.
    """
    if len(shares) <= size:
        return np.arange(len(shares)), np.ones(len(shares))
    sure = np.zeros(len(shares), dtype=bool)
    while True:
        left = np.where(sure, 0.0, shares)
        scaled = (size - sure.sum()) * (left / max(left.sum(), np.finfo(float).tiny))
        more = ~sure & (scaled >= 1.0)
        if not more.any():
            break
        sure |= more
    chance = np.where(sure, 1.0, scaled)
    steps = np.floor(np.cumsum(chance) + offset)
    drawn = np.flatnonzero(np.diff(steps, prepend=0.0) >= 1.0)
    return drawn, chance[drawn]
