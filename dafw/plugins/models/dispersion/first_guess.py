"""Distributions of the first guess of the wind: Weibull by its moments, wrapped normal."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.special import gamma, gammaln

from dafw.core.space import TWO_PI


def weibull_parameters(mean: float, sd: float) -> tuple[float, float]:
    """Return the shape k and the scale lambda of the Weibull distribution with a given mean and standard deviation.

    k solves Gamma(1 + 2/k) / Gamma(1 + 1/k)^2 = 1 + (sd / mean)^2; the left side decreases with k.

    Args:
        mean: above 0.
        sd: standard deviation, above 0, in the units of ``mean``.
    """
    wanted = np.log1p((sd / mean) ** 2)
    shape = brentq(lambda k: gammaln(1 + 2 / k) - 2 * gammaln(1 + 1 / k) - wanted, 0.05, 1e4, xtol=1e-13, rtol=1e-13)
    return float(shape), float(mean / gamma(1 + 1 / shape))


def draw_speed(mean: float, sd: float, generator: np.random.Generator) -> float:
    """Return one wind speed in the units of ``mean``; the mean itself if it or the standard deviation is 0."""
    if sd == 0.0 or mean == 0.0:
        return mean
    shape, scale = weibull_parameters(mean, sd)
    return float(scale * generator.weibull(shape))


def draw_direction(mean: float, sd: float, generator: np.random.Generator) -> float:
    """Return one direction in [0, 2 pi) from a normal distribution that is wrapped; all in radians."""
    reduced = float(np.mod(mean + sd * generator.standard_normal(), TWO_PI))
    return 0.0 if reduced >= TWO_PI else reduced
