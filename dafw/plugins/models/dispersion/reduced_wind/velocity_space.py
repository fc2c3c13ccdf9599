"""The divergence-free velocities of one mesh: the space in which a reduced basis lives.

A velocity here is an array (2 m,) over the unrolled dofs of ``MixedSpace.velocity_space`` (x and y alternate). The
velocities that vanish on the boundary and are weakly divergence-free make up a space V. For test functions in V the
pressure drops out of the equations. With the inner product a(u, v) = int grad u : grad v and the unit Reynolds number
R, a wind u = lift + v with v in V satisfies

    v + R riesz(convection(u) u) = 0.

Here ``riesz(f)`` is the velocity z of the Stokes flow with a(z, v) = f(v) for all v in V, and ``lift`` is the Stokes
flow under the boundary wind, which is orthogonal to V.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, identity, kron

from dafw.plugins.models.dispersion.fem.factorisation import Factorisation
from dafw.plugins.models.dispersion.fem.taylor_hood import TaylorHood
from dafw.plugins.models.dispersion.wind.boundary import WindBoundary

# isort: split
import basix
import basix.ufl
import ufl
from dolfinx import fem


class VelocitySpace:
    """Inner products, convection and Stokes flow of velocity arrays.

    Attributes:
        size: number 2 m of the dofs of a velocity.
        dirichlet: (2 m, 2 m) the inner product a as a matrix.
        mass: (2 m, 2 m) the L2 inner product, in m^2.
        lifts: (2 m, 2) the Stokes flows under the unit winds to the east and to the north.
    """

    def __init__(self, problem: TaylorHood, boundary: WindBoundary):
        """Factorise the Stokes problem; ``boundary`` must prescribe the same unknowns for all directions."""
        self._problem = problem
        self.size = problem.velocity_dofs.size
        self._stokes = Factorisation(problem.sparsity)
        self._fixed, east = boundary.conditions(0.0)
        _, north = boundary.conditions(0.5 * np.pi)
        self._stokes.factorise(problem.jacobian(np.zeros(problem.unknowns), 0.0), self._fixed)

        space = problem.velocity_space
        mesh = space.mesh
        self._scalars = fem.functionspace(mesh, ("Lagrange", 2))
        self._node = np.empty(self.size // 2, dtype=np.int64)  # the node in the velocity space of every scalar dof
        self._node[self._scalars.dofmap.list.ravel()] = space.dofmap.list.ravel()
        u, v = ufl.TrialFunction(self._scalars), ufl.TestFunction(self._scalars)
        self._velocity = fem.Function(space)
        self._convection = fem.form(ufl.dot(self._velocity, ufl.grad(u)) * v * ufl.dx)
        self._workspace = fem.create_matrix(self._convection)
        self.dirichlet = self._both(fem.assemble_matrix(fem.form(ufl.inner(ufl.grad(u), ufl.grad(v)) * ufl.dx)))
        self.mass = self._both(fem.assemble_matrix(fem.form(u * v * ufl.dx)))
        self.lifts = np.stack([self._lift(values) for values in (east, north)], axis=1)

    def _both(self, scalar: fem.MatrixCSR) -> csr_matrix:
        """Return the matrix (2 m, 2 m) that applies a matrix of the scalar space to both components."""
        position = np.argsort(self._node)
        return csr_matrix(kron(scalar.to_scipy()[position][:, position], identity(2)))

    def _lift(self, values: np.ndarray) -> np.ndarray:
        """Return the velocity (2 m,) of the Stokes flow with the boundary values (n,)."""
        force = self._problem.residual(values, 0.0)
        force[self._fixed] = 0.0
        return (values - self._stokes.solve(force))[self._problem.velocity_dofs]

    def flow(self, load: np.ndarray) -> np.ndarray:
        """Return all mixed unknowns (n,) of the Stokes flow under a load (2 m,), at rest on the boundary."""
        force = np.zeros(self._problem.unknowns)
        force[self._problem.velocity_dofs] = load
        force[self._fixed] = 0.0
        return self._stokes.solve(force)

    def riesz(self, load: np.ndarray) -> np.ndarray:
        """Return the velocity (2 m,) of V that represents a load (2 m,) in the inner product a."""
        return self.flow(load)[self._problem.velocity_dofs]

    def by_component(self, velocities: np.ndarray) -> np.ndarray:
        """Return velocities (2 m, k) as (m, 2 k), in the numbering of the scalar space that ``convection`` acts on."""
        return velocities.reshape(self.size // 2, -1)[self._node]

    def convection(self, velocity: np.ndarray) -> csr_matrix:
        """Return the scalar matrix (m, m) of int (w . grad u) v; ``velocity`` (2 m,) is w."""
        self._velocity.x.array[:] = velocity
        self._workspace.data[:] = 0.0
        fem.assemble_matrix(self._workspace, self._convection)
        return self._workspace.to_scipy()

    def noise(self, rng: np.random.Generator) -> np.ndarray:
        """Return a random load (2 m,) with mean zero and the mass matrix as its covariance: white noise."""
        mesh, degree = self._scalars.mesh, 4  # integrates products of P2 functions exactly
        element = basix.ufl.quadrature_element(mesh.basix_cell(), value_shape=(2,), degree=degree)
        white = fem.Function(fem.functionspace(mesh, element))
        _, weights = basix.make_quadrature(basix.CellType.triangle, degree)
        constants = fem.functionspace(mesh, ("DG", 0))
        areas = fem.assemble_vector(fem.form(ufl.TestFunction(constants) * ufl.dx)).array
        volumes = 2.0 * areas[constants.dofmap.list.ravel(), None] * weights  # of every quadrature point
        values = white.x.array.reshape(-1, 2)
        values[white.function_space.dofmap.list] = (
            rng.standard_normal((*volumes.shape, 2)) / np.sqrt(volumes)[:, :, None]
        )
        test = ufl.TestFunction(self._problem.velocity_space)
        measure = ufl.dx(metadata={"quadrature_degree": degree})
        return fem.assemble_vector(fem.form(ufl.inner(white, test) * measure)).array
