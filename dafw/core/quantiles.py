"""Quantiles over weighted members. Values may be infinite: a time that never comes is later than all.

The quantile of a probability p is the smallest value at which the weight of the values up to it reaches p. So it is a
member's value, and infinite ones need no care.
"""

from __future__ import annotations

import numpy as np

from dafw.core.space import Array

ROUNDING = 1e-9
"""Weights are sums of rounded numbers: so much less than a probability is enough to reach it."""


def quantile(values: Array, weights: Array | None, probability: float) -> Array:
    """Return the quantile (...) of values (N, ...): the smallest value whose cumulated weight reaches ``probability``.

    ``weights`` (N,) add up to one; None: all values count equally. A value without weight is no quantile.

    >>> quantile(np.array([3.0, 1.0, np.inf, 2.0]), None, 0.5)
    array(2.)
    """
    count = len(values)
    if weights is None:
        rank = min(count - 1, max(0, int(np.ceil(probability * count - ROUNDING)) - 1))
        return np.asarray(np.sort(values, axis=0)[rank])
    order = np.argsort(values, axis=0, kind="stable")
    cumulated = np.cumsum(weights[order], axis=0)
    reached = (cumulated >= probability - ROUNDING) & (cumulated > 0.0)
    reached[-1] = True
    first = np.argmax(reached, axis=0)
    return np.asarray(np.take_along_axis(np.take_along_axis(values, order, axis=0), first[np.newaxis], axis=0)[0])
