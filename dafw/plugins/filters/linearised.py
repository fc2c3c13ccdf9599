"""A proposal about the places where the linearised model fits the readings best.

Around samples z_p with weights w_p and predictions h_p, the model is taken for linear, h(z) = h_c + J (z - c), with the
slopes J of a weighted linear regression of h on z. Readings y with the errors s of the likelihood, and the error e that
the regression leaves, then ask for a step from a centre c to ::

    c + A^-1 (J^T D (y - h_c) + B (z_0 - c)),    A = J^T D J + B,    D = power / (s^2 + e^2)

The power is what a reading counts: less if it is an outlier and tails are heavy. B is the inverse of the covariance of
the samples times ``REACH``^2, about their mean z_0: a step does not lead far away from where the regression knows
anything. Where the model is far from linear, e is large and the step is short; so the
steps get longer as the samples get closer. The next batch is drawn about the ends of the steps with the covariance
A^-1. The weights of importance sampling make good for all that is approximate here.

It is a Gauss-Newton step whose gradient is that of an ensemble (Bocquet and Sakov 2014, doi:10.1002/qj.2236).
"""

from __future__ import annotations

import numpy as np

from dafw.core.space import Array
from dafw.core.window import Window
from dafw.plugins.filters.candidates import Candidates
from dafw.plugins.filters.controls import Controls
from dafw.plugins.filters.kernels import SMALLEST_SD, Kernels
from dafw.plugins.filters.likelihood import Likelihood
from dafw.plugins.filters.weights import effective_size, systematic

REACH = 2.0
"""Length of a step that is taken for likely, in standard deviations of the samples."""


def can_linearise(controls: Controls, weights: Array) -> bool:
    """Return whether enough samples count for a regression on the k controls."""
    return effective_size(weights) > len(controls) + 2.0


def linearised(
    controls: Controls,
    samples: Candidates,
    weights: Array,
    chosen: Array,
    window: Window,
    likelihood: Likelihood,
    n_centres: int,
    offset: float,
) -> Kernels:
    """Return a proposal about the ends of the steps from ``n_centres`` samples.

    Args:
        controls: the control variables.
        samples: P candidates.
        weights: (P,) of the regression; add up to one.
        chosen: (P,) the centres are drawn from these weights.
        window: has the readings.
        likelihood: gives the errors s.
        n_centres: how many steps are made.
        offset: a uniform draw from [0, 1).
    """
    k, best = len(controls), int(np.argmax(chosen))
    places = controls.offset(samples.coordinates, samples.coordinates[best])
    mean = weights @ places
    away, changes = places - mean, samples.predicted - weights @ samples.predicted
    # In coordinates in which the samples' covariance is the identity, so that nothing is ill-conditioned.
    root = np.linalg.cholesky((away.T * weights) @ away + SMALLEST_SD**2 * np.eye(k))
    away = np.linalg.solve(root, away.T).T
    slopes = (away.T * weights) @ changes  # (k, M), J transposed
    left = weights @ (changes - away @ slopes) ** 2
    errors = likelihood.variances(samples.predicted[best], samples.fit[best], window.values, window.covariance) + left
    missed = window.values - samples.predicted
    pull = likelihood.pull(missed[best] ** 2 / errors) / errors
    precision = (slopes * pull) @ slopes.T + np.eye(k) / REACH**2
    centres = systematic(chosen, n_centres, offset)
    asked = (missed[centres] * pull) @ slopes.T - away[centres] / REACH**2
    steps = np.linalg.solve(precision, asked.T).T
    ends = samples.coordinates[best] + places[centres] + steps @ root.T
    factor = lower_factor(np.linalg.solve(np.linalg.cholesky(precision), root.T))
    return Kernels(controls, ends[np.newaxis], factor[np.newaxis])


def lower_factor(root: Array) -> Array:
    """Return the Cholesky factor (k, k) of root^T root + ``SMALLEST_SD``^2, without forming the product."""
    upper = np.linalg.qr(np.vstack([root, SMALLEST_SD * np.eye(len(root))]), mode="r")
    return np.asarray((upper * np.sign(np.diag(upper))[:, np.newaxis]).T)
