"""The wind in a reduced basis: Newton's method in some hundred unknowns, and an estimate of the error.

The unit wind is u = cos d l_0 + sin d l_1 + sum_i a_i phi_i with two Stokes flows l and r modes phi. The modes are
divergence-free and orthonormal in a(., .) (velocity_space.py). Galerkin's equations are exact, nothing is interpolated:

    a_i + R sum_jk T_ijk c_j c_k = 0,    c = (cos d, sin d, a),    T_ijk = int (u_j . grad u_k) . phi_i

Error estimate: the residual of the full equations is a load. The Stokes flow z under that load is the error where
convection is weak. The L2 norm of z is estimated from random functionals g with the covariance E g(z)^2 = |z|^2, at a
cost that does not depend on the mesh: Smetana, Zahm and Patera, SIAM J. Sci. Comput. 41 (2019), doi:10.1137/18M120364X,
for a dual norm. That |z| bounds the error also for the R of a basis is an observation, not a theorem:
docs/fast-winds.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dafw.plugins.models.dispersion.reduced_wind.basis import ReducedBasis

SAFETY = 1.5
"""Factor on the estimate, for the randomness of the functionals and for the part of the error that |z| misses."""
SMALL_STEP = 1e-3
"""Relative length of a Newton step after which the iteration ends.

The equations are quadratic, so the error that is left is about its square, 1e-6.
"""
MAX_ITERATIONS = 15


@dataclass(frozen=True)
class ReducedWind:
    """A wind in a reduced basis.

    Attributes:
        coefficients: (n,) cos d, sin d, then those of the modes.
        error: estimated relative L2 error of the velocity; infinite if the iteration failed.
        iterations: Newton steps taken.
    """

    coefficients: np.ndarray
    error: float
    iterations: int


class ReducedFlow:
    """Solves in a reduced basis. A result depends only on the basis and on the arguments."""

    def __init__(self, basis: ReducedBasis):
        self.basis = basis
        modes = basis.quadratic.shape[0]
        # With half of the modes a Newton step takes an eighth of the work, and that is mostly accurate enough. With all
        # modes from the start a whole run takes 45 % longer.
        sizes = (modes // 2, 3 * modes // 4, modes)
        self._stages = [np.ascontiguousarray(basis.quadratic[:r, : r + 2, : r + 2]) for r in sizes]
        n = modes + 2
        self._pairs = np.triu_indices(n)
        self._weights = np.where(self._pairs[0] == self._pairs[1], 1.0, 2.0)

    def solve(self, reynolds: float, direction: float, accepted: float = 0.0) -> ReducedWind:
        """Return the wind; its error is infinite if none was found.

        It is solved with half of the modes, then with three quarters, then with all, until the estimated error is
        accepted. Coefficients of unused modes are zero.

        Args:
            reynolds: unit Reynolds number in 1/m.
            direction: towards which the air moves, in radians.
            accepted: relative L2 error that is accepted; 0 uses all modes.
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
        # If no error is accepted, the stage with three quarters of the modes costs more than it saves.
        for tensor in self._stages if accepted > 0.0 else (self._stages[0], self._stages[-1]):
            more = solve_modes(tensor, reynolds, coefficients[: tensor.shape[1]])
            iterations += more
            if more == MAX_ITERATIONS or not np.isfinite(coefficients).all():
                return ReducedWind(coefficients, np.inf, iterations)
            error = self.error(reynolds, coefficients)
            if error <= accepted:
                break
        return ReducedWind(coefficients, error, iterations)

    def error(self, reynolds: float, coefficients: np.ndarray) -> float:
        """Return the estimated L2 error of the velocity, relative to its L2 norm.

        Args:
            reynolds: unit Reynolds number in 1/m.
            coefficients: (n,) those of the velocity.
        """
        first, second = self._pairs
        products = self._weights * coefficients[first] * coefficients[second]
        basis = self.basis
        values = basis.functionals @ coefficients + reynolds * (basis.functionals_quadratic @ products)
        norm = np.sqrt(coefficients @ basis.gram @ coefficients)
        return float(SAFETY * np.sqrt(np.mean(values**2)) / norm)


def solve_modes(tensor: np.ndarray, reynolds: float, coefficients: np.ndarray, small_step: float = SMALL_STEP) -> int:
    """Solve the reduced equations by Newton's method; return the number of steps, ``MAX_ITERATIONS`` after a failure.

    Args:
        tensor: (r, n, n) the tensor T of the modes that are used, n = r + 2.
        reynolds: unit Reynolds number in 1/m.
        coefficients: (n,) the start, which is overwritten with the solution; the first two stay.
        small_step: relative length of a step after which the iteration ends.
    """
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
