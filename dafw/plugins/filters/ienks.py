"""The iterative ensemble Kalman smoother: a Gauss-Newton search in the space of the ensemble, then a transform.

The controls at the beginning of the window are x = c + w a, with the mean c of the ensemble and its anomalies a (r, k)
in an orthonormal basis B (N, r) of weights with zero mean. The first guess says that w (r,) is Gaussian with the
covariance I / (N - 1). With the readings y of the window, their errors R and their prediction h(x), which runs the
model, the most probable w minimises ::

    J(w) = (N - 1) / 2 |w|^2 + 1/2 |y - h(c + w a)|^2_R

In each iteration members are placed around the present w by deviations B S (N, r) and run. With their predictions'
anomalies P (N, M), and the readings less the mean prediction dy (M,), both in units of the errors::

    Y  = least-squares solution of (B S) Y = P                       sensitivities (r, M)
    H  = (N - 1) I + Y Y^T                                           (r, r)
    w <- w - H^-1 ((N - 1) w - Y dy)
    T  = sqrt(N - 1) H^-1/2                                          symmetric root

The variant ``transform`` takes S = T, so that members lie as far apart as the analysis believes. ``bundle`` takes
S = epsilon I, so that Y is the derivative at w and the search ends in the minimum of J (MAP).

J is computed with the mean prediction of the members, so values for different S cannot be compared. If a step of
``transform`` increased J, the search goes back and continues with S as it is; from then on, and in ``bundle`` always, a
step that increased J is halved. The search ends if w moves by less than ``tolerance`` of the first guess's standard
deviation, or after ``iterations``; in that case the last step counts only if J is the smallest so far, unless it is the
only one. The members after the analysis are c + (w + B T) a, run to the present.

The basis B has r = N - 1 columns. But if members differ in their controls alone, and there are fewer controls, B spans
only what moves the controls: predictions depend on nothing else, and a regression on all N - 1 weights would take what
is not linear in the controls for an effect of weights that have none. Where other numbers differ as well, the first
iteration counts them as unknown; later ones take their effect for a larger one of the controls, because it does not
shrink with S. So the controls should be all that is unknown.

For a linear model and Gaussian errors, one iteration finds mean and covariance of the Kalman filter at the end of the
window, and of the Rauch-Tung-Striebel smoother within it.

Bocquet and Sakov (2014), doi:10.1002/qj.2236; Bocquet and Sakov (2012), doi:10.5194/npg-19-383-2012.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dafw.core.options import option
from dafw.core.space import Array
from dafw.plugins.filters.rerunning import Rerunning, Run, Work, reached
from dafw.plugins.filters.rotation import zero_mean_basis

SINGULAR = 1e-10
"""Singular values of the controls' anomalies below this part of the largest are zero."""


class Weights:
    """Members at the beginning of a window by their weights (N, r): ``run`` places them at weights and runs them.

    Attributes:
        basis: B (N, r).
        weights: where the members were in the last run, which may be nearer to the run before than they were sent.
    """

    def __init__(self, work: Work, *, few: bool = False) -> None:
        """Take all N - 1 weights; ``few``: only those that move the controls, if members differ in nothing else."""
        self._work = work
        self._centre, anomalies = work.spread(work.first)
        self.basis = zero_mean_basis(len(anomalies))
        if few and work.differ_in_controls_alone(self._centre):
            axes, sizes, _ = np.linalg.svd(self.basis.T @ anomalies, full_matrices=False)
            self.basis = self.basis @ axes[:, : max(1, np.count_nonzero(sizes > SINGULAR * sizes[0]))]
        self._a = work.inflation * (self.basis.T @ anomalies)
        self.weights: Array = self.basis / work.inflation

    def run(self, weights: Array, *, last: bool = False) -> Run:
        """Return the run of members at ``weights`` (N, r), and remember where they really were."""
        run = self._work.run(self._centre + weights @ self._a, self._centre + self.weights @ self._a, last=last)
        self.weights = reached(self.weights, weights, run.tries)
        return run

    @property
    def mean(self) -> Array:
        """The mean weights w (r,)."""
        return np.asarray(self.weights.mean(axis=0))


def newton_step(weights: Array, run: Run) -> tuple[Array, Array]:
    """Return w (r,) after a Gauss-Newton step, and T (r, r).

    ``weights`` (N, r) are those of the members of the ``run``.
    """
    n1, w = len(weights) - 1, weights.mean(axis=0)
    Y = np.linalg.lstsq(weights - w, run.anomalies, rcond=None)[0]  # noqa: N806
    d, V = np.linalg.eigh(Y @ Y.T)  # noqa: N806
    d = np.maximum(d, 0.0) + n1
    gradient = n1 * w - Y @ run.innovation
    return w - V @ ((V.T @ gradient) / d), (V * np.sqrt(n1 / d)) @ V.T


@dataclass
class IEnKS(Rerunning):
    """Gauss-Newton in the ensemble's space over a window: of a fixed number of cycles, or of all since the start."""

    accuracy = "exact"

    window: int | None = option(
        None, "cycles to look back and revise with new readings; null: from the start, with all readings", minimum=1
    )
    iterations: int = option(10, "at most so many Gauss-Newton iterations; each is a re-run", minimum=1)
    tolerance: float = option(1e-3, "the search ends with a step below this, in first-guess deviations", above=0.0)
    variant: str = option("transform", "where the members of an iteration lie", choices=("transform", "bundle"))
    epsilon: float = option(1e-4, "deviations of the variant bundle, relative to the first guess's", above=0.0)

    def moved_start(self, work: Work, rng: np.random.Generator) -> Run:
        """Return the run of c + (w + B T) a."""
        place, n1 = Weights(work, few=True), len(work.first) - 1
        basis, size = place.basis, place.basis.shape[1]
        w, T = np.zeros(size), np.eye(size)  # noqa: N806
        fixed = self.variant == "bundle"
        S = self.epsilon * T if fixed else T  # noqa: N806
        best, least, found = w, np.inf, False
        for _ in range(self.iterations):
            run = place.run(w + basis @ S)
            cost = cost_of(place.weights, run)
            if cost > least and not fixed:
                fixed, w, least = True, best, np.inf
                continue
            if cost <= least:
                best, least = place.mean, cost
                w, T = newton_step(place.weights, run)  # noqa: N806
                S = S if fixed else T  # noqa: N806
            else:
                w = 0.5 * (best + place.mean)
            found = bool(np.sqrt(n1) * np.linalg.norm(w - best) < self.tolerance)
            if found:
                break
        run = place.run(w + basis @ T, last=True)
        if self.iterations > 1 and not found and cost_of(place.weights, run) > least:
            run = place.run(best + basis @ T, last=True)
        return run


def cost_of(weights: Array, run: Run) -> float:
    """Return J at the mean of the weights (N, r), with the mean prediction of the run's members for h."""
    w = weights.mean(axis=0)
    return float(0.5 * ((len(weights) - 1) * w @ w + run.innovation @ run.innovation))
