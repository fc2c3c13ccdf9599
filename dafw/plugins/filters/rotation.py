"""Random orthogonal matrices, and a basis for those that do not change the mean of an ensemble."""

from __future__ import annotations

from functools import cache

import numpy as np

from dafw.core.space import Array


@cache
def zero_mean_basis(n_members: int) -> Array:
    """Return N - 1 orthonormal columns (N, N - 1), each of zero mean.

    They are the Householder reflection that exchanges the first unit vector and the constant unit vector, without its
    first column.
    """
    normal = np.full(n_members, -1.0 / np.sqrt(n_members))
    normal[0] += 1.0
    basis = np.eye(n_members)[:, 1:] - np.outer(normal, normal[1:]) * (2.0 / (normal @ normal))
    basis.setflags(write=False)
    return basis


def uniform_orthogonal(size: int, rng: np.random.Generator) -> Array:
    """Return a uniformly distributed orthogonal matrix (size, size); Stewart (1980), doi:10.1137/0717034.

    ``scipy.stats.ortho_group`` draws the same matrix in the same time. But nothing else in such a run needs
    ``scipy.stats``, and importing it takes 0.5 s or more: a whole run of ``experiment=lorenz96`` would take 5.0 instead
    of 3.4 s (medians of five runs each, made alternately).
    """
    Q, R = np.linalg.qr(rng.standard_normal((size, size)))  # noqa: N806
    # Without these signs Q would not be uniform: the factorisation has its own convention for the signs of R.
    return np.asarray(Q * np.copysign(1.0, R.diagonal()))
