"""Localization: a correlation that falls to zero with the distance."""

from __future__ import annotations

import numpy as np

from dafw.core.space import Array


def gaspari_cohn(distance: Array) -> Array:
    """Return the correlation at a distance in units of half the radius: 1 at 0, 0 from 2 on. Any shape.

    Gaspari and Cohn (1999), Eq. 4.10, doi:10.1002/qj.49712555417.
    """
    r = np.minimum(distance, 2.0)
    inner = 1.0 - 5.0 / 3.0 * r**2 + 0.625 * r**3 + 0.5 * r**4 - 0.25 * r**5
    with np.errstate(divide="ignore"):
        outer = 4.0 - 5.0 * r + 5.0 / 3.0 * r**2 + 0.625 * r**3 - 0.5 * r**4 + r**5 / 12.0 - 2.0 / (3.0 * r)
    return np.where(r <= 1.0, inner, np.where(r < 2.0, np.maximum(outer, 0.0), 0.0))


def not_negative(matrix: Array) -> Array:
    """Return the nearest symmetric matrix without negative eigenvalues; ways around walls may make some."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
