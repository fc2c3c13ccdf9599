"""Means along lines of the gas of a steady leak, as the sum of the puffs that it has sent out.

Every moment the leak at (x, y) on the ground sends out a puff, which the wind carries along while it grows. A puff of
age a that has been carried by D has, per gram, at a distance r from its centre and at the height z the concentration ::

    exp(-r^2 / (2 s^2)) / (2 pi s^2) * 2 exp(-z^2 / (2 h^2)) / (sqrt(2 pi) h)        g m^-3

with the widths s(a) and h(a); the ground reflects. Its mean along a line of length L from A with the unit vector e, at
the height z, is exact: with the distance n of the centre from the line, and its place l along it, ::

    exp(-n^2 / (2 s^2)) / (sqrt(2 pi) s) * (Phi((L - l) / s) - Phi(-l / s)) / L * (the factor of the height)

So there is no mesh, and no numerical diffusion. The sum over ages is a quadrature in the middle of intervals that grow
with the age; the widths grow with it, too, so that neighbouring puffs overlap.

The loops are compiled by numba, without its fast mathematics.
"""

from __future__ import annotations

from math import erf, exp, pi, sqrt

import numpy as np
from numba import njit

from dafw.core.space import Array

FAR = 4.0
"""Widths beyond which a puff is not felt."""


def ages_to(oldest: float, first: float, growth: float) -> tuple[Array, Array]:
    """Return ages (a,) in s in the middle of intervals that fill 0 to ``oldest``, and the intervals' lengths (a,).

    The first is ``first`` seconds long, and each is longer than the one before by the ``growth`` times its beginning.
    """
    edges = [0.0]
    while edges[-1] < oldest:
        edges.append(min(oldest, edges[-1] + first + growth * edges[-1]))
    ends = np.array(edges)
    return 0.5 * (ends[1:] + ends[:-1]), np.diff(ends)


@njit(cache=True)
def path_means(
    leaks: np.ndarray,
    shapes: np.ndarray,
    carried: np.ndarray,
    turbulence: np.ndarray,
    ages: np.ndarray,
    lengths: np.ndarray,
    lines: np.ndarray,
    heights: np.ndarray,
    widest: float,
) -> np.ndarray:
    """Return means (N, p) in g m^-3 per g/s, averaged over the moments.

    Args:
        leaks: (N, 2) places in m.
        shapes: (N, 6) turn of the wind in radians, counter-clockwise, factor on its speed, widths s and h at age 0 in
            m, and how they grow, as shares of the turbulence.
        carried: (k, a, 2) in m: how far the wind carried the puff of every age at each of the k moments.
        turbulence: (k, 2) standard deviations of the wind's components in m/s, horizontal and upwards.
        ages: (a,) in s.
        lengths: (a,) of the intervals of ages in s.
        lines: (p, 5) start x and y, unit vector x and y, length; in m.
        heights: (p,) of the lines above the ground in m.
        widest: the largest h in m: the air above it does not mix.
    """
    n_members, n_moments, n_ages, n_lines = leaks.shape[0], carried.shape[0], ages.size, lines.shape[0]
    means = np.zeros((n_members, n_lines))
    west, east, south, north = np.inf, -np.inf, np.inf, -np.inf
    for line in range(n_lines):
        for place in (0.0, lines[line, 4]):
            x, y = lines[line, 0] + lines[line, 2] * place, lines[line, 1] + lines[line, 3] * place
            west, east, south, north = min(west, x), max(east, x), min(south, y), max(north, y)
    for member in range(n_members):
        turn, speed, wide, high, spread, lift = shapes[member]
        cos, sin = np.cos(turn) * speed, np.sin(turn) * speed
        for moment in range(n_moments):
            for number in range(n_ages):
                age = ages[number]
                s = sqrt(wide**2 + (spread * turbulence[moment, 0] * age) ** 2)
                h = min(sqrt(high**2 + (lift * turbulence[moment, 1] * age) ** 2), widest)
                dx, dy = carried[moment, number]
                x = leaks[member, 0] + cos * dx - sin * dy
                y = leaks[member, 1] + sin * dx + cos * dy
                reach = FAR * s
                if x < west - reach or x > east + reach or y < south - reach or y > north + reach:
                    continue
                for line in range(n_lines):
                    x_off, y_off = x - lines[line, 0], y - lines[line, 1]
                    across = (lines[line, 2] * y_off - lines[line, 3] * x_off) / s
                    if abs(across) > FAR:
                        continue
                    along, length = lines[line, 2] * x_off + lines[line, 3] * y_off, lines[line, 4]
                    if along < -reach or along > length + reach:
                        continue
                    part = 0.5 * (erf((length - along) / (s * sqrt(2.0))) - erf(-along / (s * sqrt(2.0))))
                    upright = exp(-0.5 * (heights[line] / h) ** 2) / (pi * h * s)
                    means[member, line] += lengths[number] * exp(-0.5 * across**2) * part * upright / length
    return means / n_moments
