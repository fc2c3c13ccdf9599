"""Taylor-Hood P2/P1 discretisation of the steady incompressible Navier-Stokes equations on triangles.

The equations are those of a wind of unit intensity, divided by the viscosity::

    -lap u + R (u . grad) u + grad q = f,   div u = 0,     R = intensity / viscosity  (unit Reynolds number, 1/m)

so that they depend on R alone, and R = 0 is the Stokes problem. The physical wind is ``intensity * u`` and the physical
kinematic pressure ``viscosity * intensity * q``. Taylor & Hood, Computers & Fluids 1 (1973),
doi:10.1016/0045-7930(73)90027-3.

The equations are quadratic in (u, q). The part that is linear in the unknowns is assembled once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem, la
from scipy.sparse import csr_matrix

from dafw.plugins.models.dispersion.fem.mixed_space import MixedSpace
from dafw.plugins.models.dispersion.fem.sparsity import Sparsity, total


class TaylorHood(MixedSpace):
    """The discrete residual and its Jacobian, as arrays over the mixed unknowns that this rank owns.

    Attributes:
        sparsity: the sparsity pattern of the Jacobian.
    """

    def __init__(self, mesh: Any):
        super().__init__(mesh)

        (u, p), (v, q) = ufl.TrialFunctions(self.space), ufl.TestFunctions(self.space)
        self._state = fem.Function(self.space)
        w, _ = ufl.split(self._state)
        linear = ufl.inner(ufl.grad(u), ufl.grad(v)) - p * ufl.div(v) - q * ufl.div(u)
        convection = ufl.inner(ufl.dot(ufl.grad(w), w), v)
        derivative = ufl.inner(ufl.dot(ufl.grad(u), w) + ufl.dot(ufl.grad(w), u), v)
        self._convection = fem.form(convection * ufl.dx)
        self._derivative = fem.form(derivative * ufl.dx)

        form = fem.form(linear * ufl.dx)
        self.sparsity = pattern = Sparsity(form)
        values = pattern.assemble(form).copy()
        self._linear = csr_matrix((values, pattern.indices, pattern.indptr), shape=pattern.shape)
        self._assembled = la.vector(self._state.x.index_map)

    def residual(self, unknowns: np.ndarray, reynolds: float, load: np.ndarray | None = None) -> np.ndarray:
        """Return the residual (n,) of the equations.

        Args:
            unknowns: (n,) velocity and pressure of the unit wind.
            reynolds: unit Reynolds number in 1/m.
            load: (n,) assembled body force, or None.
        """
        self._set_state(unknowns)
        self._assembled.array[:] = 0.0
        fem.assemble_vector(self._assembled.array, self._convection)
        self._assembled.scatter_reverse(la.InsertMode.add)
        residual = self._assembled.array[: self.unknowns] * reynolds
        residual += self._linear @ self.sparsity.with_ghosts(unknowns)
        return residual if load is None else residual - load

    def jacobian(self, unknowns: np.ndarray, reynolds: float) -> np.ndarray:
        """Return the derivative of the residual as CSR values (z,) on ``sparsity``.

        Args:
            unknowns: (n,) velocity and pressure of the unit wind.
            reynolds: unit Reynolds number in 1/m.
        """
        self._set_state(unknowns)
        return self._linear.data + reynolds * self.sparsity.assemble(self._derivative)

    def _set_state(self, unknowns: np.ndarray) -> None:
        self._state.x.array[: self.unknowns] = unknowns
        self._state.x.scatter_forward()

    def dot(self, a: np.ndarray, b: np.ndarray) -> float:
        """Return the scalar product of two vectors (n,) over all ranks, with the same bits on each."""
        return float(total(self.sparsity.comm, float(a @ b)))

    def norm(self, a: np.ndarray) -> float:
        """Return the Euclidean norm of a vector (n,) over all ranks."""
        return float(np.sqrt(self.dot(a, a)))
