"""The gas of a steady leak at points, as the sum of the puffs that it has sent out (path_means.py has the formula).

The loops are compiled by numba, without its fast mathematics.
"""

from __future__ import annotations

from math import exp, pi, sqrt

import numpy as np
from numba import njit

from dafw.plugins.models.puffs.path_means import FAR


@njit(cache=True)
def point_levels(
    leaks: np.ndarray,
    shapes: np.ndarray,
    carried: np.ndarray,
    turbulence: np.ndarray,
    ages: np.ndarray,
    lengths: np.ndarray,
    points: np.ndarray,
    widest: float,
) -> np.ndarray:
    """Return concentrations (N, k) in g m^-3 per g/s, at each of k moments at the point of that moment.

    ``points`` (k, 3) are x, y and the height above the ground in m; the other arguments are those of ``path_means``.
    """
    n_members, n_moments, n_ages = leaks.shape[0], carried.shape[0], ages.size
    levels = np.zeros((n_members, n_moments))
    for member in range(n_members):
        turn, speed, wide, high, spread, lift = shapes[member]
        cos, sin = np.cos(turn) * speed, np.sin(turn) * speed
        for moment in range(n_moments):
            to_x, to_y = points[moment, 0] - leaks[member, 0], points[moment, 1] - leaks[member, 1]
            for number in range(n_ages):
                age = ages[number]
                s = sqrt(wide**2 + (spread * turbulence[moment, 0] * age) ** 2)
                dx, dy = carried[moment, number]
                x_off, y_off = (to_x - cos * dx + sin * dy) / s, (to_y - sin * dx - cos * dy) / s
                squared = x_off**2 + y_off**2
                if squared > FAR**2:
                    continue
                h = min(sqrt(high**2 + (lift * turbulence[moment, 1] * age) ** 2), widest)
                upright = 2.0 * exp(-0.5 * (points[moment, 2] / h) ** 2) / (sqrt(2.0 * pi) * h)
                levels[member, moment] += lengths[number] * exp(-0.5 * squared) / (2.0 * pi * s**2) * upright
    return levels
