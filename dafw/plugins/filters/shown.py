"""Drawing the few members of a belief from many weighted samples: rare clouds are shown, with a small weight.

Ten members drawn in proportion to the weights do not show a cloud that one sample in thirty has, and a policy that
knows the members alone never looks there. So the chance of a sample falls with the weight m of all samples whose
clouds overlap with its own ::

    chance ~ w / sqrt(m),    weight of the member ~ w / chance

A group of similar samples of total weight M then gets a share of the members proportional to sqrt(M). Averages keep
their expectation. If all samples have about the same cloud, it is an ordinary draw.
"""

from __future__ import annotations

import numpy as np

from dafw.core.ensemble import Ensemble
from dafw.core.space import NONNEGATIVE, Array, IntArray
from dafw.plugins.filters.weights import without_repeats

EMPTY = 1e-6
"""A cloud of less than this share of the largest one (root of the sum of squares) is no cloud."""


def members_drawn(samples: Ensemble, weights: Array, size: int, offset: float) -> tuple[IntArray, Array]:
    """Return the indices (N,) of samples that become members, and their weights (N,); N is ``size``.

    ``offset`` is a uniform draw from [0, 1); with the same one, most members stay from one analysis to the next.
    If there are fewer samples than members, those of the largest weights are taken several times.
    """
    drawn, chance = without_repeats(weights / np.sqrt(similar(samples, weights)), size, offset)
    shares = weights[drawn] / chance
    if len(drawn) < size:  # too few samples, or round-off in the sum of the chances
        most = np.argsort(-weights, kind="stable")[np.arange(size - len(drawn)) % len(weights)]
        drawn = np.concatenate([drawn, most])
        copies = np.bincount(drawn, minlength=len(weights))
        shares = weights[drawn] / copies[drawn]
    return drawn, shares / shares.sum()


def similar(samples: Ensemble, weights: Array) -> Array:
    """Return for each sample the weight (P,) of all samples, each as far as its cloud overlaps with that of the sample.

    The overlap of two clouds a and b is a . b / max(|a|^2, |b|^2); that of two empty ones is 1. The clouds are the
    variables with several nonnegative numbers. In a state without any, all samples are similar.
    """
    parts = [samples.space.slice(v.name) for v in samples.space.variables if v.kind is NONNEGATIVE and v.size > 1]
    if not parts:
        return np.ones(len(samples))
    clouds = np.concatenate([samples.members[:, part] for part in parts], axis=1)
    products = clouds @ clouds.T
    squares = np.diag(products)
    empty = squares <= EMPTY**2 * squares.max()
    larger = np.maximum(np.maximum.outer(squares, squares), np.finfo(float).tiny)
    overlap = np.where(np.logical_and.outer(empty, empty), 1.0, np.clip(products / larger, 0.0, 1.0))
    np.fill_diagonal(overlap, 1.0)
    return np.asarray(np.maximum(overlap @ weights, np.finfo(float).tiny))
