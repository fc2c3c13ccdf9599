"""ES-MDA: the ensemble smoother with multiple data assimilation.

The control variables at the beginning of the window are updated with all readings of the analysis in several small
steps, each with the readings' errors inflated and with a re-run of the model. In step i, with the controls' anomalies
A (N, k) in the coordinates of dafw.plugins.filters.rerunning, the predictions' anomalies Y (N, M) and the readings less
each member's predictions D (N, M), both in units of the readings' errors, and standard normal draws Z (N, M)::

    Y    = U diag(s) V^T                                                  singular values in descending order
    x   <- x + (D + sqrt(alpha_i) Z) V diag(s / (s^2 + (N - 1) alpha_i)) U^T A
    sum_i 1 / alpha_i = 1

For a linear model and Gaussian errors, all steps together are one update with the errors as they are, so mean and
covariance are the Kalman filter's in the limit of many members. Otherwise each step is small, and the next begins with
predictions of the members as moved. The coefficients are equal (alpha_i is the number of steps), or decrease by the
same factor from each step to the next (``decrease`` > 1): the first steps, whose predictions are worst, count least.

The inversion is one in the space of the ensemble, however many readings there are. ``energy`` < 1 leaves out the small
singular values, beyond the first that hold this share of the sum of all s^2: what many readings agree on is kept, and
chance correlations of few members are not.

Emerick and Reynolds (2013), doi:10.1016/j.cageo.2012.03.011; subspace inversion: Evensen (2004),
doi:10.1007/s10236-004-0099-2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dafw.core.options import option
from dafw.core.space import Array
from dafw.plugins.filters.rerunning import Rerunning, Run, Work


def coefficients(n_steps: int, decrease: float) -> Array:
    """Return alpha (n_steps,): each is ``decrease`` times smaller than the one before; sum 1 / alpha = 1."""
    parts = decrease ** np.arange(n_steps, dtype=np.float64)
    return np.asarray(parts.sum() / parts)


def gain(anomalies: Array, alpha: float, energy: float) -> Array:
    """Return V diag(s / (s^2 + (N - 1) alpha)) U^T (M, N) of predicted anomalies (N, M) in units of the errors."""
    U, s, Vt = np.linalg.svd(anomalies, full_matrices=False)  # noqa: N806
    if energy < 1.0:
        shares = np.cumsum(s**2)
        kept = 1 + int(np.searchsorted(shares, energy * shares[-1]))
        U, s, Vt = U[:, :kept], s[:kept], Vt[:kept]  # noqa: N806
    return np.asarray((Vt.T * (s / (s**2 + (len(anomalies) - 1) * alpha))) @ U.T)


@dataclass
class ESMDA(Rerunning):
    """Several small stochastic updates of the control variables, each with a run of the model."""

    window: int | None = option(
        None, "cycles to look back and revise with new readings; null: from the start, with all readings", minimum=1
    )
    iterations: int = option(4, "small steps of an analysis; each is a re-run, and there is one more", minimum=1)
    decrease: float = option(1.0, "factor by which alpha decreases from one step to the next", minimum=1.0)
    energy: float = option(1.0, "share of the predictions' variance kept in the inversion", above=0.0, maximum=1.0)

    def moved_start(self, work: Work, rng: np.random.Generator) -> Run:
        """Return the run of the members after the last step."""
        centre, anomalies = work.spread(work.first)
        before, coordinates = centre + anomalies, centre + self.inflation * anomalies
        for alpha in coefficients(self.iterations, self.decrease):
            run = work.run(coordinates, before)
            centre, anomalies = work.spread(run.start.ensemble.members)
            perturbed = run.missed + np.sqrt(alpha) * rng.standard_normal(run.missed.shape)
            before = centre + anomalies
            # In the cheapest order: no matrix as large as the square of many members, or of many readings.
            step = np.linalg.multi_dot([perturbed, gain(run.anomalies, alpha, self.energy), anomalies])
            coordinates = before + step
        return work.run(coordinates, before, last=True)
