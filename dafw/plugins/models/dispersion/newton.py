"""Newton's method for the quadratic Navier-Stokes residual: exact line search, factorisation kept while it pays.

The residual F is a quadratic polynomial, so along a Newton direction d, F(x + s d) = (1 - s) F(x) + s^2 F(x + d): the
step length that minimises its norm costs one residual. Between factorisations the last one serves again for as long
as it still reduces the residual well (Shamanskii's method; Kelley, Solving Nonlinear Equations with Newton's Method,
SIAM 2003, doi:10.1137/1.9780898718898).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dafw.plugins.models.dispersion.taylor_hood import TaylorHood

# isort: split
from petsc4py import PETSc

KEEP = 0.3
"""A kept factorisation serves on while each step reduces the residual to this fraction; a new one costs ten steps."""
STALLED = 0.9
"""Newton has stalled where its best step leaves more than this fraction of the residual."""


@dataclass(frozen=True)
class Iterate:
    """Where a Newton iteration ended: the vector (n,), its residual norm, factorisations spent, whether it is good."""

    unknowns: np.ndarray
    residual: float
    factorisations: int
    converged: bool


class Newton:
    """Newton's method with MUMPS for a ``TaylorHood`` problem; one ordering serves all its factorisations.

    ``single`` factorises in single precision: seven digits for the memory of half, where they only precondition.
    On a partitioned mesh all ranks call together, arrays are those that each owns, and all decide alike.
    """

    def __init__(self, problem: TaylorHood, *, single: bool = False):
        self._problem, self._single = problem, single
        # Every entry of the pattern stays, zero or not: the ordering must not depend on the first matrix solved.
        self._values = np.zeros(problem.indices.size)
        self._matrix = problem.sparsity.petsc(self._values)
        self._solver = PETSc.KSP().create(problem.sparsity.comm)
        self._solver.setOperators(self._matrix)
        self._solver.setType("preonly")
        preconditioner = self._solver.getPC()
        preconditioner.setType("lu")
        preconditioner.setFactorSolverType("mumps")
        preconditioner.setFactorSetUpSolverType()
        mumps = preconditioner.getFactorMatrix()
        mumps.setMumpsIcntl(7, 5)  # ordering: METIS
        mumps.setMumpsIcntl(6, 0)  # no permutation by value: the analysis sees the pattern alone
        mumps.setMumpsIcntl(8, 7)  # scaling by rows and columns, anew with each factorisation
        mumps.setMumpsIcntl(14, 100)  # per cent of extra workspace for pivots that are put off
        self._right, self._left = self._matrix.createVecRight(), self._matrix.createVecLeft()

    def factorise(self, values: np.ndarray, fixed: np.ndarray) -> None:
        """Factorise a Jacobian, given as CSR values that are overwritten, with the ``fixed`` unknowns left out."""
        problem = self._problem
        fixed_entry = fixed[problem.rows] | problem.sparsity.with_ghosts(fixed)[problem.indices]
        values[fixed_entry] = problem.rows[fixed_entry] == problem.indices[fixed_entry]
        self._values[:] = values
        problem.sparsity.refresh(self._matrix, self._values)
        self._solver.setOperators(self._matrix)
        if not self._single:
            self._solver.setUp()
            return
        options: Any = PETSc.Options()
        options["pc_precision"] = "single"  # the one way to tell PETSc, which reads it now
        try:
            self._solver.setUp()
        finally:
            options.delValue("pc_precision")

    @property
    def megabytes(self) -> int:
        """The memory of the last factorisation in MB of 10^6 bytes, as MUMPS counts it."""
        return int(self._solver.getPC().getFactorMatrix().getMumpsInfog(22))

    def back_substitute(self, right: np.ndarray) -> np.ndarray:
        """Return the solution (n,) by the last factorisation, not-a-number where it or the solve failed."""
        self._left.array[:] = right
        self._solver.solve(self._left, self._right)
        if not self._solver.is_converged:
            return np.full(right.size, np.nan)
        return self._right.array.copy()

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
        """Iterate from ``start`` (n,) until the norm of the residual is at most ``target``.

        Where ``fixed`` (n,) is true, the unknown keeps its value in ``start`` and its equation is left out.
        ``max_iterations`` bounds the factorisations; without ``keep`` each step has its own. The caller must look at
        ``converged``.
        """

        def residual(x: np.ndarray) -> np.ndarray:
            r = self._problem.residual(x, reynolds, load)
            r[fixed] = 0.0
            return r

        x, count = start.copy(), 0
        force = residual(x)
        norm = self._problem.norm(force)
        while target < norm < np.inf and count < max_iterations:
            self.factorise(self._problem.jacobian(x, reynolds), fixed)
            count += 1
            direction = -self.back_substitute(force)
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
                x, force, norm = self._keep(residual, x, force, norm, target)
        return Iterate(x, norm, count, bool(norm <= target))  # a not-a-number compares false

    def _keep(
        self,
        residual: Callable[[np.ndarray], np.ndarray],
        x: np.ndarray,
        force: np.ndarray,
        norm: float,
        target: float,
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """Go on with the last factorisation while it reduces the residual well."""
        while norm > target:
            trial = x - self.back_substitute(force)
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
    """Return s in (0, 1] that minimises |(1 - s) force + s^2 quadratic|, both (n,), in the norm of ``dot``."""
    a, b, c = float(dot(force, force)), float(dot(force, quadratic)), float(dot(quadratic, quadratic))
    if c <= 0.25 * a:
        return 1.0  # the full step already halves the residual
    # |.|^2 = a (1-s)^2 + 2 b s^2 (1-s) + c s^4, a quartic with minima at the roots of its derivative
    roots = np.roots([4.0 * c, -6.0 * b, 2.0 * a + 4.0 * b, -2.0 * a])
    candidates = [1.0] + [float(r.real) for r in roots if abs(r.imag) < 1e-12 * abs(r) and 0.0 < r.real < 1.0]
    return min(candidates, key=lambda s: a * (1 - s) ** 2 + 2 * b * s**2 * (1 - s) + c * s**4)
