"""Newton's method for the quadratic Navier-Stokes residual, with an exact line search.

The residual F is a quadratic polynomial. Along a Newton direction d,

    F(x + s d) = (1 - s) F(x) + s^2 F(x + d),

so the step length s that minimises its norm costs one more residual. A factorisation is used again as long as it
reduces the residual well (Shamanskii's method; Kelley, Solving Nonlinear Equations with Newton's Method, SIAM 2003,
doi:10.1137/1.9780898718898).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dafw.plugins.models.dispersion.fem.factorisation import Factorisation
from dafw.plugins.models.dispersion.fem.iterate import Iterate
from dafw.plugins.models.dispersion.fem.taylor_hood import TaylorHood

KEEP = 0.3
"""A factorisation is kept while every step with it leaves at most this fraction of the residual.

A new factorisation takes the time of about ten such steps.
"""
STALLED = 0.9
"""Newton's method has stalled if its best step leaves more than this fraction of the residual."""


class NewtonSolver:
    """Newton's method for one ``TaylorHood`` problem.

    On a mesh that is divided among several ranks all methods are collective calls, vectors hold the unknowns that the
    rank owns, and all ranks take the same decisions.

    Attributes:
        factorisation: that of the last Jacobian.
    """

    def __init__(self, problem: TaylorHood):
        self._problem = problem
        self.factorisation = Factorisation(problem.sparsity)

    def solve(
        self,
        start: np.ndarray,
        reynolds: float,
        fixed: np.ndarray,
        target: float,
        max_iterations: int,
        load: np.ndarray | None = None,
        keep: bool = True,
    ) -> Iterate:
        """Iterate until the norm of the residual is at most ``target``; look at ``converged`` of what comes back.

        Args:
            start: (n,) the first vector, which holds the prescribed values.
            reynolds: unit Reynolds number in 1/m.
            fixed: (n,) bool; these unknowns keep their values, and their equations are left out.
            target: Euclidean norm of the residual to reach.
            max_iterations: how many factorisations may be made.
            load: (n,) assembled body force, or None.
            keep: use a factorisation again while it reduces the residual well.
        """

        def residual(x: np.ndarray) -> np.ndarray:
            r = self._problem.residual(x, reynolds, load)
            r[fixed] = 0.0
            return r

        x, count = start.copy(), 0
        force = residual(x)
        norm = self._problem.norm(force)
        while target < norm < np.inf and count < max_iterations:
            self.factorisation.factorise(self._problem.jacobian(x, reynolds), fixed)
            count += 1
            direction = -self.factorisation.solve(force)
            quadratic = residual(x + direction)
            if not np.isfinite(self._problem.dot(quadratic, quadratic)):
                break
            length = best_length(force, quadratic, self._problem.dot)
            x = x + length * direction
            force, before = quadratic if length == 1.0 else residual(x), norm
            norm = self._problem.norm(force)
            if norm > STALLED * before:
                break
            if keep and length == 1.0:
                x, force, norm = self._reuse(residual, x, force, norm, target)
        return Iterate(x, norm, count, bool(norm <= target))  # false if the norm is not a number

    def _reuse(
        self,
        residual: Callable[[np.ndarray], np.ndarray],
        x: np.ndarray,
        force: np.ndarray,
        norm: float,
        target: float,
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Take more steps with the last factorisation; return the vector (n,), its residual (n,) and its norm."""
        while norm > target:
            trial = x - self.factorisation.solve(force)
            trial_force = residual(trial)
            trial_norm = self._problem.norm(trial_force)
            if not trial_norm < norm:
                break
            pays = trial_norm <= KEEP * norm
            x, force, norm = trial, trial_force, trial_norm
            if not pays:
                break
        return x, force, norm


def best_length(
    force: np.ndarray, quadratic: np.ndarray, dot: Callable[[np.ndarray, np.ndarray], float] = np.dot
) -> float:
    """Return the s in (0, 1] that minimises the norm of (1 - s) ``force`` + s^2 ``quadratic``.

    Args:
        force: (n,) residual at the start of the step.
        quadratic: (n,) residual after the full step.
        dot: the scalar product that defines the norm.
    """
    a, b, c = float(dot(force, force)), float(dot(force, quadratic)), float(dot(quadratic, quadratic))
    if c <= 0.25 * a:
        return 1.0  # the full step already halves the residual
    # The squared norm is a (1-s)^2 + 2 b s^2 (1-s) + c s^4; its minima are among the roots of the derivative.
    roots = np.roots([4.0 * c, -6.0 * b, 2.0 * a + 4.0 * b, -2.0 * a])
    candidates = [1.0] + [float(r.real) for r in roots if abs(r.imag) < 1e-12 * abs(r) and 0.0 < r.real < 1.0]
    return min(candidates, key=lambda s: a * (1 - s) ** 2 + 2 * b * s**2 * (1 - s) + c * s**4)
