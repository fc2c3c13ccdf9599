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
from dolfinx import fem, la
from scipy.sparse import csr_matrix

from dafw.plugins.models.dispersion.partition import nearest
from dafw.plugins.models.dispersion.sparsity import Sparsity, total


class MixedSpace:
    """Velocity and pressure of one mesh; of a partitioned mesh, arrays hold the unknowns that this rank owns.

    Attributes:
        space: the mixed DOLFINx space, velocity first.
        velocity_space, pressure_space: the P2 vector space and the P1 space.
        velocity_dofs: (2 m,) mixed unknown of every unrolled dof of ``velocity_space`` (x and y alternate).
        pressure_dofs: (k,) mixed unknown of every dof of ``pressure_space``.
    """

    def __init__(self, mesh: Any):
        velocity = basix.ufl.element("Lagrange", mesh.basix_cell(), 2, shape=(mesh.geometry.dim,))
        pressure = basix.ufl.element("Lagrange", mesh.basix_cell(), 1)
        self.space = fem.functionspace(mesh, basix.ufl.mixed_element([velocity, pressure]))
        self.velocity_space, velocity_dofs = self.space.sub(0).collapse()
        self.pressure_space, pressure_dofs = self.space.sub(1).collapse()
        # The unknowns of other ranks come last.
        nodes, points = self.velocity_space.dofmap.index_map.size_local, self.pressure_space.dofmap.index_map.size_local
        self.velocity_dofs = np.array(velocity_dofs).ravel()[: 2 * nodes]
        self.pressure_dofs = np.array(pressure_dofs).ravel()[:points]

    def places_in(self, whole: MixedSpace) -> np.ndarray:
        """Return for every mixed unknown (n,) which one it is in the space on the same mesh, not partitioned."""
        pairs = (whole.velocity_space, self.velocity_space), (whole.pressure_space, self.pressure_space)
        velocity, pressure = (nearest(*(space.tabulate_dof_coordinates() for space in pair)) for pair in pairs)
        places = np.empty(self.velocity_dofs.size + self.pressure_dofs.size, dtype=np.int64)
        nodes = velocity[: self.velocity_dofs.size // 2]
        places[self.velocity_dofs] = whole.velocity_dofs.reshape(-1, 2)[nodes].ravel()
        places[self.pressure_dofs] = whole.pressure_dofs[pressure[: self.pressure_dofs.size]]
        return places


class TaylorHood(MixedSpace):
    """The discrete residual and its Jacobian as plain arrays over the mixed unknowns that this rank owns: all, on one.

    Attributes:
        unknowns: their number n.
        sparsity: that of the Jacobian; ``indptr``, ``indices``, ``rows`` are its arrays.
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
        self.unknowns = pattern.size
        self.indptr, self.indices, self.rows = pattern.indptr, pattern.indices, pattern.rows
        self._linear = csr_matrix((pattern.assemble(form).copy(), self.indices, self.indptr), shape=pattern.shape)
        self._assembled = la.vector(self._state.x.index_map)

    def residual(self, unknowns: np.ndarray, reynolds: float, load: np.ndarray | None = None) -> np.ndarray:
        """Return the residual (n,) of the equations; ``load`` (n,) is the assembled body force, if there is one."""
        self._set_state(unknowns)
        self._assembled.array[:] = 0.0
        fem.assemble_vector(self._assembled.array, self._convection)
        self._assembled.scatter_reverse(la.InsertMode.add)
        residual = self._assembled.array[: self.unknowns] * reynolds
        residual += self._linear @ self.sparsity.with_ghosts(unknowns)
        return residual if load is None else residual - load

    def jacobian(self, unknowns: np.ndarray, reynolds: float) -> np.ndarray:
        """Return the derivative of the residual as CSR values on (``indptr``, ``indices``)."""
        self._set_state(unknowns)
        return self._linear.data + reynolds * self.sparsity.assemble(self._derivative)

    def _set_state(self, unknowns: np.ndarray) -> None:
        self._state.x.array[: self.unknowns] = unknowns
        self._state.x.scatter_forward()

    def velocity(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the dofs of ``velocity_space`` (2 m,) of a mixed vector (n,)."""
        return unknowns[self.velocity_dofs]

    def dot(self, a: np.ndarray, b: np.ndarray) -> float:
        """Return the scalar product of two vectors (n,) over all ranks, the same number on each."""
        return float(total(self.sparsity.comm, float(a @ b)))

    def norm(self, a: np.ndarray) -> float:
        """Return the Euclidean norm of a vector (n,) over all ranks."""
        return float(np.sqrt(self.dot(a, a)))
