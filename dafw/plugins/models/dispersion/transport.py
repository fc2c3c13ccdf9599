"""Transport of a gas by a given wind: advection and diffusion, P1 finite elements, backward Euler.

    dc/dt + w . grad c - epsilon lap c = f,    c = 0 on the outer boundary,    dc/dn = 0 on walls

Gioia et al. 2024, equations (AD) and (W-AD), doi:10.1109/SDF63218.2024.10773899; docs/physics.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dafw.core.errors import ContractError, SolverError
from dafw.core.options import option
from dafw.plugins.models.dispersion.mesh import OUTER, TaggedMesh

STRONG = 12.0
"""A wind is strong where the entries beside the diagonal add up to so many times the one on it in one row of twenty.

Below, BiCGStab with ILU mostly takes ten iterations or fewer; not far above it fails, and a sparse LU is quicker.
"""
SYSTEMS_BYTES = 2e9
"""Memory of one process for the systems of its members, about."""


@dataclass
class TransportOptions:
    """Options of the transport."""

    diffusion: float = option(0.8, "diffusion coefficient epsilon in m^2/s", minimum=0.0)
    scheme: str = option("galerkin", "galerkin, or supg: stabilised along the wind", choices=("galerkin", "supg"))
    tolerance: float = option(
        1e-12, "residual norm of the linear solver, relative to the right-hand side", above=0.0, maximum=1e-6
    )
    max_iterations: int = option(
        100, "iterations of the linear solver in one step, after which it is solved directly", minimum=1
    )


class Transport:
    """What no wind changes: the mass and stiffness matrices of one mesh, for steps of ``dt`` seconds.

    On a mesh that is partitioned among several ranks all of them call together, and arrays hold the nodes that the rank
    owns.
    """

    def __init__(self, tagged_mesh: TaggedMesh, options: TransportOptions, dt: float):
        from dafw.plugins.models.dispersion import libraries  # noqa: F401  (before dolfinx)

        # isort: split
        import ufl
        from dolfinx import fem

        from dafw.plugins.models.dispersion.sparsity import Sparsity

        mesh = tagged_mesh.mesh
        self.options, self.dt = options, dt
        self._space = fem.functionspace(mesh, ("Lagrange", 1))
        velocity_space = fem.functionspace(mesh, ("Lagrange", 2, (mesh.geometry.dim,)))
        self._velocity = w = fem.Function(velocity_space)

        c, v = ufl.TrialFunction(self._space), ufl.TestFunction(self._space)
        mass = fem.form(c * v * ufl.dx)
        stiffness = fem.form(ufl.inner(ufl.grad(c), ufl.grad(v)) * ufl.dx)
        advected = ufl.dot(w, ufl.grad(c))
        self._advection, self._advected_mass = fem.form(advected * v * ufl.dx), None
        if options.scheme == "supg":
            weight = self._intrinsic_time(mesh) * ufl.dot(w, ufl.grad(v))
            # 4 integrates the products exactly; the intrinsic time is not a polynomial
            measure = ufl.dx(metadata={"quadrature_degree": 4})
            self._advection = fem.form(advected * v * ufl.dx + advected * weight * measure)
            self._advected_mass = fem.form(c * weight * measure)

        # All P1 matrices of the mesh share one sparsity, so that they add up entry by entry.
        self.sparsity = Sparsity(mass)
        self.nodes = self.sparsity.size
        self.indptr, self.indices, rows = self.sparsity.indptr, self.sparsity.indices, self.sparsity.rows
        self.places: np.ndarray = self._space.tabulate_dof_coordinates()[: self.nodes, : mesh.geometry.dim]
        self._mass, self._stiffness = self._assemble(mass), self._assemble(stiffness)
        outer = fem.locate_dofs_topological(self._space, mesh.topology.dim - 1, tagged_mesh.facet_tags.find(OUTER))
        self.outer = outer[outer < self.nodes]
        fixed = np.zeros(self.nodes, dtype=bool)
        fixed[self.outer] = True
        self._fixed_entries = fixed[rows] | self.sparsity.with_ghosts(fixed)[self.indices]
        self._fixed_diagonal = fixed[rows] & (rows == self.indices)
        self._diagonal = np.flatnonzero(rows == self.indices)

    def is_strong(self, after: np.ndarray) -> bool:
        """Say whether the wind of a matrix (CSR values) is too strong for an iteration; the same on all ranks."""
        from dafw.plugins.models.dispersion.sparsity import total

        diagonal = np.abs(after[self._diagonal])
        beside = np.add.reduceat(np.abs(after), self.indptr[:-1]) - diagonal
        counts = np.array([np.count_nonzero(beside > STRONG * diagonal), self.nodes])
        strong, nodes = total(self.sparsity.comm, counts)
        return bool(20 * strong > nodes)

    @property
    def systems_kept(self) -> int:
        """For how many members a process keeps a system of its own; the others share one."""
        bytes_of_one = 80 * self.indices.size  # measured: 60 with incomplete factors, 100 where the wind is strong
        return max(1, int(SYSTEMS_BYTES / bytes_of_one))

    def _intrinsic_time(self, mesh: Any) -> Any:
        """Return the time scale of SUPG; Shakib et al. 1991, doi:10.1016/0045-7825(91)90041-4, with element metric."""
        import ufl

        # The metric's unit is 1/m^2: along a unit vector a of an element of length h, a . G a is about 1 / h^2.
        inverse = ufl.JacobianInverse(mesh)
        metric = ufl.dot(inverse.T, inverse)
        along = ufl.dot(self._velocity, ufl.dot(metric, self._velocity))
        across = self.options.diffusion**2 * ufl.inner(metric, metric)
        return 1.0 / ufl.sqrt((2.0 / self.dt) ** 2 + 4.0 * along + 72.0 * across)

    def uniform_velocity(self, intensity: float, direction: float) -> Any:
        """Return the same wind everywhere (m/s, and radians towards which the air moves) as a DOLFINx function."""
        from dolfinx import fem

        function = fem.Function(self._velocity.function_space)
        function.x.array.reshape(-1, 2)[:] = intensity * np.array([np.cos(direction), np.sin(direction)])
        return function

    def system(self, velocity: Any, reuse: TransportSystem | None = None) -> TransportSystem:
        """Return the steps in one wind: ``velocity`` is a DOLFINx vector function (m/s) of the mesh, P2 or less.

        ``reuse`` is a system of this transport that is given up; to make it over takes half the time.
        """
        advection = self.advection(velocity)
        if self._advected_mass is None:
            return self.system_of(advection, reuse)
        return self._system(advection, (self._mass + self._assemble(self._advected_mass)) / self.dt, reuse)

    def system_of(self, advection: np.ndarray, reuse: TransportSystem | None = None) -> TransportSystem:
        """Return the steps in one wind from its advection matrix; in Galerkin's scheme that is all there is of it."""
        return self._system(advection, self._mass / self.dt, reuse)

    def advection(self, velocity: Any) -> np.ndarray:
        """Return the advection matrix of a wind as CSR values on (``indptr``, ``indices``).

        In Galerkin's scheme it is linear in the wind: the matrix of a sum of winds is the sum of their matrices.
        """
        self._velocity.interpolate(velocity)
        self._velocity.x.scatter_forward()
        return self._assemble(self._advection)

    def _system(self, advection: np.ndarray, before: np.ndarray, reuse: TransportSystem | None) -> TransportSystem:
        after = before + self.options.diffusion * self._stiffness + advection
        after[self._fixed_entries] = 0.0
        after[self._fixed_diagonal] = 1.0
        system = reuse or TransportSystem(self)
        system.change(after, before)
        return system

    def _assemble(self, form: Any) -> np.ndarray:
        return self.sparsity.assemble(form).copy()


class TransportSystem:
    """Steps of the transport in one wind, its matrix and preconditioner kept: made by ``Transport.system``."""

    def __init__(self, transport: Transport):
        from petsc4py import PETSc
        from scipy.sparse import csr_matrix

        self._transport = transport
        sparsity = transport.sparsity
        self._values = np.zeros(transport.indices.size)
        self._before = csr_matrix((self._values.copy(), transport.indices, transport.indptr), shape=sparsity.shape)
        self._after = sparsity.petsc(self._values)
        solver: Any = PETSc.KSP().create(sparsity.comm)
        solver.setType("bcgs")
        solver.setPCSide(PETSc.PC.Side.RIGHT)  # so that the norm watched is that of the true residual
        solver.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        # Without fill, a strong wind can keep BiCGStab from converging.
        solver.getPC().setType("ilu" if sparsity.comm.size == 1 else "bjacobi")
        solver.getPC().setFactorLevels(1)
        solver.setInitialGuessNonzero(True)
        options = transport.options
        solver.setTolerances(rtol=options.tolerance, atol=0.0, max_it=options.max_iterations)
        self._solver: Any = solver
        self._direct: Any = None
        self._strong = False
        self._right, self._left = self._after.createVecRight(), self._after.createVecLeft()

    def change(self, after: np.ndarray, before: np.ndarray) -> None:
        """Take the CSR values of the matrices on the new (``after``) and on the old (``before``) concentration."""
        self._values[:] = after
        self._before.data[:] = before
        self._transport.sparsity.refresh(self._after, self._values)
        if self._direct is not None:
            self._direct.destroy()  # by all ranks together: dropped, its factors would stay on several
            self._direct = None
        self._strong = self._transport.is_strong(after)
        if self._strong:
            return
        self._solver.setOperators(self._after)
        self._solver.setUp()  # what depends on the pattern alone is done the first time
        if self._transport.sparsity.comm.size > 1:
            for block in self._solver.getPC().getBJacobiSubKSP():
                block.getPC().setType("ilu")
                block.getPC().setFactorLevels(1)

    @property
    def solved_directly(self) -> bool:
        """Whether the wind is too strong for an iteration."""
        return self._strong

    def step(self, concentration: np.ndarray, source: np.ndarray | None = None) -> np.ndarray:
        """Return the concentration (nodes,) one time step later.

        ``source`` (nodes,) is the rate f at the end of the step, in concentration per second. Raises SolverError where
        the tolerance is not reached and ContractError where an array has another shape.
        """
        transport = self._transport
        for array in (concentration,) if source is None else (concentration, source):
            if array.shape != (transport.nodes,):
                raise ContractError(f"transport: expected {transport.nodes} nodal values, got shape {array.shape}")
        supplied = concentration if source is None else concentration + transport.dt * source
        self._left.array[:] = self._before @ transport.sparsity.with_ghosts(supplied)
        self._left.array[transport.outer] = 0.0
        self._right.array[:] = concentration
        self._right.array[transport.outer] = 0.0
        if not self._strong:
            self._solver.solve(self._left, self._right)
        if self._strong or self._solver.getConvergedReason() <= 0:
            self._solve_directly()
        return self._right.array.copy()

    def _solve_directly(self) -> None:
        """Solve with a sparse LU, made once per wind."""
        from petsc4py import PETSc

        if self._direct is None:
            self._direct = PETSc.KSP().create(self._transport.sparsity.comm)
            self._direct.setOperators(self._after)
            self._direct.setType("preonly")
            self._direct.getPC().setType("lu")
            self._direct.getPC().setFactorSolverType("mumps")
        self._direct.solve(self._left, self._right)
        missed = self._left.duplicate()
        self._after.mult(self._right, missed)
        missed.aypx(-1.0, self._left)
        # What round-off leaves grows with the matrix: the backward error is what a direct solve can be held to.
        scale = self._left.norm() + self._after.norm(PETSc.NormType.NORM_INFINITY) * self._right.norm()
        residual, tolerance = missed.norm(), self._transport.options.tolerance
        if not residual <= tolerance * scale:
            raise SolverError(
                f"transport: a direct solve left a residual of {residual:.3g}, expected at most {tolerance:.3g} times "
                f"{scale:.3g}"
            )
