"""Whether a sample explains the readings: whether it misses them by no more than their errors make likely.

Good weights say which samples are better than others, not that any is good. A prediction h misses a reading y with an
error of the scale s (likelihood.py) by m = (y - h) / s. Compared with an exact prediction of the same scale, this costs
the logarithm of the likelihood ::

    d = m^2 / 2                                    normal errors
    d = (v + 1) / 2 log(1 + m^2 / v)               Student t errors with v degrees of freedom

If m is such an error, d has the mean and the variance ::

    1/2                                            1/2
    (v + 1) / 2 (psi((v + 1) / 2) - psi(v / 2))    ((v + 1) / 2)^2 (psi'(v / 2) - psi'((v + 1) / 2))

because m^2 / v is then a ratio of two gamma variables. K readings count as k = K ``independence``. They are explained
if ``independence`` sum d <= k mean + 2 sqrt(k variance) + 1, and if the model's error that this takes is not the
largest of several sizes: with it, a wrong sample may explain readings where the drone happens to be.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dafw.core.space import Array
from dafw.core.window import Window
from dafw.plugins.filters.candidates import Candidates
from dafw.plugins.filters.likelihood import Likelihood
from dafw.plugins.filters.slow_sensors import as_shown


def is_explained(window: Window, samples: Candidates, likelihood: Likelihood) -> bool:
    """Return whether the best sample explains all readings so far, for the errors that fit it best.

    Readings below a detection limit are left out: it is not known by how much they are missed. With backgrounds, which
    explain readings as well as samples do, nothing is judged: it is True.
    """
    values = window.values
    if likelihood.has_background or not values.size:
        return True
    best = np.array([int(np.argmax(likelihood.averaged(samples.fit)))])
    fit = samples.fit[best]
    if errs_most(samples, likelihood):
        return False
    shown = as_shown(window, samples.predicted[best], fit, np.ones(1), likelihood)[0]
    # Correlations play no part here, and the covariance of all readings may be a large matrix.
    variances = np.concatenate([cycle.observation.variance for cycle in window.cycles])
    seen = _is_seen(window, values, likelihood)
    missed = ((values - shown) ** 2 / likelihood.variances(shown, fit[0], values, variances))[seen]
    degrees = likelihood.degrees_of_freedom
    if degrees is None:
        cost, mean, variance = 0.5 * missed, 0.5, 0.5
    else:
        from scipy.special import digamma, polygamma

        half = 0.5 * (degrees + 1.0)
        cost = half * np.log1p(missed / degrees)
        mean = float(half * (digamma(half) - digamma(0.5 * degrees)))
        variance = float(half**2 * (polygamma(1, 0.5 * degrees) - polygamma(1, half)))
    count = likelihood.independence * missed.size
    return bool(likelihood.independence * cost.sum() <= 1.0 + count * mean + 2.0 * np.sqrt(count * variance))


def errs_most(samples: Candidates, likelihood: Likelihood) -> bool:
    """Return whether the best sample needs the largest of several sizes of the model's error, absolute or relative."""
    best = int(np.argmax(likelihood.averaged(samples.fit)))
    used = likelihood.sizes[int(np.argmax(samples.fit[best])) % len(likelihood.sizes)]
    sizes = likelihood.absolute, likelihood.relative
    return any(len(set(size)) > 1 and one == max(size) for one, size in zip(used, sizes, strict=True))


def _is_seen(window: Window, values: Array, likelihood: Likelihood) -> NDArray[np.bool_]:
    """Return whether each of the readings ``values`` (M,) is a value, not only something below a limit."""
    seen = []
    for cycle in window.cycles:
        limits = cycle.observation.operator.limits
        seen.append(np.ones(cycle.observation.values.size, dtype=np.bool_) if limits is None else np.isnan(limits))
    own = np.concatenate(seen)
    limit = likelihood.detection_limit
    return own if limit is None else np.logical_and(own, values >= limit)
