"""The wind in a reduced basis: Newton's method in some hundred unknowns, and an estimate of the error that it leaves.

The unit wind is u = cos d l_0 + sin d l_1 + sum_i a_i phi_i with two Stokes flows l and r modes phi, divergence-free
and orthonormal in a(., .) (velocity_space.py). Galerkin's equations are exact, there is nothing to interpolate:

    a_i + R sum_jk T_ijk c_j c_k = 0,    c = (cos d, sin d, a),    T_ijk = int (u_j . grad u_k) . phi_i

Estimate: what is left of the full equations is a load; z, the Stokes flow that it drives, is the error where convection
is weak. The L2 norm of z is estimated from m random functionals g of covariance (z, z) -> |z|^2, at a cost that does
not depend on the mesh: Smetana, Zahm and Patera, SIAM J. Sci. Comput. 41 (2019), doi:10.1137/18M120364X, for a dual
norm. That |z| bounds the error for the R of a basis, too, is an observation, not a theorem: docs/fast-winds.md.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

SAFETY = 1.5
"""On the estimate, for the randomness of the functionals and for what |z| misses."""
SMALL_STEP = 1e-3
"""Relative length of Newton's last step; the equations are quadratic, so that about its square is left: 1e-6."""
MAX_ITERATIONS = 15


@dataclass(frozen=True)
class ReducedBasis:
    """What is made once and kept on disk, n = r + 2 velocities, s snapshots, m functionals.

    ``velocities`` (2 v, n); ``quadratic`` (r, n, n) is T made symmetric in j and k; ``gram`` (n, n) the L2 products in
    m^2; ``functionals`` (m, n) and ``functionals_quadratic`` (m, n (n + 1) / 2) what the functionals make of the two
    parts of the equations, products with j <= k; ``parameters`` (s, 2) R and d of the snapshots, ``coefficients``
    (s, r) their modes.
    """

    velocities: np.ndarray
    quadratic: np.ndarray
    gram: np.ndarray
    functionals: np.ndarray
    functionals_quadratic: np.ndarray
    parameters: np.ndarray
    coefficients: np.ndarray

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays by name."""
        return {item.name: getattr(self, item.name) for item in fields(self)}


@dataclass(frozen=True)
class ReducedWind:
    """``coefficients`` (n,), cos d and sin d first, and the estimated relative L2 error of the velocity."""

    coefficients: np.ndarray
    error: float
    iterations: int


class ReducedFlow:
    """Solves in a reduced basis; results depend on the basis and on the arguments alone."""

    def __init__(self, basis: ReducedBasis):
        self.basis = basis
        modes = basis.quadratic.shape[0]
        # Half of the modes cost an eighth of the work, and mostly do.
        sizes = (modes // 2, 3 * modes // 4, modes)
        self._stages = [np.ascontiguousarray(basis.quadratic[:r, : r + 2, : r + 2]) for r in sizes]
        n = modes + 2
        self._pairs = np.triu_indices(n)
        self._weights = np.where(self._pairs[0] == self._pairs[1], 1.0, 2.0)

    def solve(self, reynolds: float, direction: float, accepted: float = 0.0) -> ReducedWind:
        """Return the wind of a unit Reynolds number (1/m) and a direction; an infinite error where there is none.

        No more modes are used, and the other coefficients zero, once the estimated error is at most ``accepted``.
        """
        turn = np.exp(1j * (self.basis.parameters[:, 1] - direction))
        scale = max(float(self.basis.parameters[:, 0].max()), 1e-300)
        distance = np.abs(np.angle(turn)) + np.abs(self.basis.parameters[:, 0] - reynolds) / scale
        nearest = self.basis.coefficients[np.argmin(distance)]
        first = self._stages[0].shape[1]
        coefficients = np.zeros(2 + nearest.size)
        coefficients[:2] = np.cos(direction), np.sin(direction)
        coefficients[2:first] = nearest[: first - 2]
        error, iterations = np.inf, 0
        # Where no error is good enough, the stages between do not pay.
        for tensor in self._stages if accepted > 0.0 else (self._stages[0], self._stages[-1]):
            more = newton(tensor, reynolds, coefficients[: tensor.shape[1]])
            iterations += more
            if more == MAX_ITERATIONS or not np.isfinite(coefficients).all():
                return ReducedWind(coefficients, np.inf, iterations)
            error = self.error(reynolds, coefficients)
            if error <= accepted:
                break
        return ReducedWind(coefficients, error, iterations)

    def error(self, reynolds: float, coefficients: np.ndarray) -> float:
        """Return the estimated L2 error of the velocity with these coefficients (n,), relative to its L2 norm."""
        first, second = self._pairs
        products = self._weights * coefficients[first] * coefficients[second]
        basis = self.basis
        values = basis.functionals @ coefficients + reynolds * (basis.functionals_quadratic @ products)
        norm = np.sqrt(coefficients @ basis.gram @ coefficients)
        return float(SAFETY * np.sqrt(np.mean(values**2)) / norm)


def newton(tensor: np.ndarray, reynolds: float, coefficients: np.ndarray, small_step: float = SMALL_STEP) -> int:
    """Solve in the modes of ``tensor`` (r, n, n), changing ``coefficients`` (n,) in place; return the iterations."""
    modes, n = tensor.shape[:2]
    by_rows, identity = tensor.reshape(modes * n, n), np.eye(modes)
    for iteration in range(1, MAX_ITERATIONS + 1):
        half = (by_rows @ coefficients).reshape(modes, n)
        residual = coefficients[2:] + reynolds * (half @ coefficients)
        try:
            step = np.linalg.solve(identity + 2.0 * reynolds * half[:, 2:], residual)
        except np.linalg.LinAlgError:
            return MAX_ITERATIONS
        coefficients[2:] -= step
        if not np.linalg.norm(step) > small_step * np.linalg.norm(coefficients):
            return iteration
    return MAX_ITERATIONS
