"""A reduced basis: what is made once for a mesh and kept on disk."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np


@dataclass(frozen=True)
class ReducedBasis:
    """A reduced basis of r modes; flow.py has the equations.

    Attributes:
        velocities: (2 m, n) the two Stokes flows, then the modes; n = r + 2.
        quadratic: (r, n, n) the tensor T of the reduced equations, symmetric in its last two indices.
        gram: (n, n) L2 products of the velocities, in m^2.
        functionals: (k, n) values of the random functionals for the linear part of the equations.
        functionals_quadratic: (k, n (n + 1) / 2) the same for the quadratic part, products i <= j in the order of
            ``numpy.triu_indices``.
        parameters: (s, 2) unit Reynolds number in 1/m and direction in radians of every snapshot.
        coefficients: (s, r) coefficients of the snapshots in the modes.
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
