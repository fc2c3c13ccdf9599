"""Probabilities over weighted members, and the values that are exceeded with a probability."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dafw.core.quantiles import quantile
from dafw.core.space import Array


def chance(happens: NDArray[np.bool_], weights: Array | None) -> Array:
    """Return the probability (...) of something that ``happens`` (N, ...) to members, true or false."""
    if weights is None:
        return np.asarray(np.mean(happens, axis=0))
    return np.asarray(np.clip(np.tensordot(weights, happens.astype(np.float64), axes=1), 0.0, 1.0))


def exceeded(values: Array, weights: Array | None, probability: float) -> Array:
    """Return the value (...) that members (N, ...) exceed with at least this probability, were it any smaller.

    It is above a threshold exactly where the threshold is exceeded with at least this probability. Unlike the
    probability itself, which jumps by the weight of a member, it can be interpolated between nodes.
    """
    return -quantile(-values, weights, probability)
