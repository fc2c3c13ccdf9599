"""Taylor-Hood P2/P1 discretisation of the steady incompressible Navier-Stokes equations on triangles.

The equations are those of a wind of unit intensity, divided by the viscosity::

    -lap u + R (u . grad) u + grad q = f,   div u = 0,     R = intensity / viscosity  (unit Reynolds number, 1/m)

so that they depend on R alone, and R = 0 is the Stokes problem. The physical wind is ``intensity * u`` and the physical
kinematic pressure ``viscosity * intensity * q``. Taylor & Hood, Computers & Fluids 1 (1973),
doi:10.1016/0045-7930(73)90027-3.

The equations are quadratic in (u, q): all that does not depend on u is assembled once, the rest is one form.
"""

from __future__ import annotations

from typing import Any

from dafw.plugins.models.dispersion import libraries  # noqa: F401  (before dolfinx)

# isort: split
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from scipy.sparse import csr_matrix


class TaylorHood:
    """The discrete residual and its Jacobian as plain arrays over all mixed unknowns.

    Attributes:
        space: the mixed DOLFINx space, velocity first.
        velocity_space, pressure_space: the P2 vector space and the P1 space.
        velocity_dofs: (2 m,) mixed unknown of every unrolled dof of ``velocity_space`` (x and y alternate).
        pressure_dofs: (k,) mixed unknown of every dof of ``pressure_space``.
        indptr, indices, rows: sparsity of the Jacobian (CSR, and the row of every entry).
    """

    def __init__(self, mesh: Any):
        velocity = basix.ufl.element("Lagrange", mesh.basix_cell(), 2, shape=(mesh.geometry.dim,))
        pressure = basix.ufl.element("Lagrange", mesh.basix_cell(), 1)
        self.space = fem.functionspace(mesh, basix.ufl.mixed_element([velocity, pressure]))
        self.velocity_space, velocity_dofs = self.space.sub(0).collapse()
        self.pressure_space, pressure_dofs = self.space.sub(1).collapse()
        self.velocity_dofs = np.array(velocity_dofs).ravel()
        self.pressure_dofs = np.array(pressure_dofs).ravel()

        (u, p), (v, q) = ufl.TrialFunctions(self.space), ufl.TestFunctions(self.space)
        self._state = fem.Function(self.space)
        w, _ = ufl.split(self._state)
        linear = ufl.inner(ufl.grad(u), ufl.grad(v)) - p * ufl.div(v) - q * ufl.div(u)
        convection = ufl.inner(ufl.dot(ufl.grad(w), w), v)
        derivative = ufl.inner(ufl.dot(ufl.grad(u), w) + ufl.dot(ufl.grad(w), u), v)
        self._convection = fem.form(convection * ufl.dx)
        self._derivative = fem.form(derivative * ufl.dx)

        matrix = fem.assemble_matrix(fem.form(linear * ufl.dx))
        self.unknowns: int = matrix.indptr.size - 1
        self.indptr = matrix.indptr.astype(np.int32)
        self.indices = matrix.indices.astype(np.int32)
        self.rows = np.repeat(np.arange(self.unknowns, dtype=np.int32), np.diff(self.indptr))
        self._linear = csr_matrix((matrix.data.copy(), self.indices, self.indptr))
        self._workspace = fem.create_matrix(self._derivative)  # same space, hence the same sparsity

    def residual(self, unknowns: np.ndarray, reynolds: float, load: np.ndarray | None = None) -> np.ndarray:
        """Return the residual (n,) of the equations; ``load`` (n,) is the assembled body force, if there is one."""
        self._state.x.array[:] = unknowns
        residual = np.zeros(self.unknowns)
        fem.assemble_vector(residual, self._convection)
        residual *= reynolds
        residual += self._linear @ unknowns
        return residual if load is None else residual - load

    def jacobian(self, unknowns: np.ndarray, reynolds: float) -> np.ndarray:
        """Return the derivative of the residual as CSR values on (``indptr``, ``indices``)."""
        self._state.x.array[:] = unknowns
        self._workspace.data[:] = 0.0
        fem.assemble_matrix(self._workspace, self._derivative)
        return self._linear.data + reynolds * self._workspace.data

    def velocity(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the dofs of ``velocity_space`` (2 m,) of a mixed vector (n,)."""
        return unknowns[self.velocity_dofs]
