"""Wider weights where the model's error is what limits: it persists, so that readings in a row say little new.

The error of a sensor is another one with every reading, that of a model is not: gas that goes the wrong way around a
building does so for a while. A likelihood that multiplies all readings is then far too sure. It is still right for the
search, because it tells good samples from bad ones at once. So only the weights with which samples are shown are made
wider, and only as far as the model is found to err. For every pair c of sizes of the model's error
(``Likelihood.sizes``) ::

    w(z) = sum_c P(c) w_c(z),    w_c(z) ~ b(z) L_c(z)^k,    k = power, and 1 for the smallest pair

with b the other factors of the weights, L_c the likelihood for the pair c, and P(c) = sum_z w(z) P(c | z) under the
weights of the search. With a power of 1 these are the weights of the search. A power k takes 1 / k readings in
a row for one.

Powers of a likelihood where no model is right: Grunwald (2012), doi:10.1007/978-3-642-34106-9_16.
"""

from __future__ import annotations

import numpy as np

from dafw.core.space import Array
from dafw.plugins.filters.likelihood import Likelihood, shares_of_cases
from dafw.plugins.filters.weights import normalized

RARE = 1e-6
"""Probability of a pair of sizes below which it adds nothing."""


def widened(log_others: Array, fit: Array, weights: Array, likelihood: Likelihood, power: float) -> Array:
    """Return the weights (P,) with which samples are shown; they add up to one.

    log_others  (P,) log b, the factors of the weights beside the likelihood
    fit         (P, T S) log likelihoods, for each response time and pair of ``sizes``
    weights     (P,) of the search; add up to one
    power       k, of all pairs but the smallest
    """
    if power == 1.0:
        return weights
    sizes = likelihood.sizes
    is_smallest = np.tile((sizes == sizes.min(axis=0)).all(axis=1), len(likelihood.response_time))
    found = np.zeros(len(weights))
    for chance, of_readings, column in zip(
        weights @ shares_of_cases(fit), np.where(is_smallest, 1.0, power), fit.T, strict=True
    ):
        if chance > RARE:
            found += chance * normalized(log_others + of_readings * column)
    return np.asarray(found / found.sum())
