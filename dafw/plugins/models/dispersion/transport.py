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

RESTARTS = 3
SYSTEMS_BYTES = 2e9
"""Memory of one process for the systems of its members."""
BREAKDOWN = -5
"""PETSc's reason where BiCGStab's search directions became orthogonal, which a restart mends."""


@dataclass
class TransportOptions:
    """Options of the transport."""

    diffusion: float = option(0.8, "diffusion coefficient epsilon in m^2/s", minimum=0.0)
    scheme: str = option("galerkin", "galerkin, or supg: stabilised along the wind", choices=("galerkin", "supg"))
    tolerance: float = option(
        1e-12, "residual norm of the linear solver, relative to the right-hand side", above=0.0, maximum=1e-6
    )
    max_iterations: int = option(500, "iterations of the linear solver in one step", minimum=1)


class Transport:
    """What no wind changes: the mass and stiffness matrices of one mesh, for steps of ``dt`` seconds."""

    def __init__(self, tagged_mesh: TaggedMesh, options: TransportOptions, dt: float):
        from dafw.plugins.models.dispersion import libraries  # noqa: F401  (before dolfinx)

        # isort: split
        import ufl
        from dolfinx import fem

        mesh = tagged_mesh.mesh
        self.options, self.dt = options, dt
        self._space = fem.functionspace(mesh, ("Lagrange", 1))
        velocity_space = fem.functionspace(mesh, ("Lagrange", 2, (mesh.geometry.dim,)))
        self._velocity = w = fem.Function(velocity_space)

        c, v = ufl.TrialFunction(self._space), ufl.TestFunction(self._space)
        mass = fem.assemble_matrix(fem.form(c * v * ufl.dx))
        stiffness = fem.assemble_matrix(fem.form(ufl.inner(ufl.grad(c), ufl.grad(v)) * ufl.dx))
        advected = ufl.dot(w, ufl.grad(c))
        self._advection, self._advected_mass = fem.form(advected * v * ufl.dx), None
        if options.scheme == "supg":
            weight = self._intrinsic_time(mesh) * ufl.dot(w, ufl.grad(v))
            # 4 integrates the products exactly; the intrinsic time is not a polynomial
            measure = ufl.dx(metadata={"quadrature_degree": 4})
            self._advection = fem.form(advected * v * ufl.dx + advected * weight * measure)
            self._advected_mass = fem.form(c * weight * measure)

        # All P1 matrices of the mesh share one sparsity, so that they add up entry by entry.
        self.nodes: int = mass.indptr.size - 1
        self.indptr, self.indices = mass.indptr.astype(np.int32), mass.indices.astype(np.int32)
        self._mass, self._stiffness = mass.data.copy(), stiffness.data.copy()
        self._workspace = fem.create_matrix(self._advection)
        self.outer = fem.locate_dofs_topological(self._space, mesh.topology.dim - 1, tagged_mesh.facet_tags.find(OUTER))
        fixed = np.zeros(self.nodes, dtype=bool)
        fixed[self.outer] = True
        rows = np.repeat(np.arange(self.nodes), np.diff(self.indptr))
        self._fixed_entries = fixed[rows] | fixed[self.indices]
        self._fixed_diagonal = fixed[rows] & (rows == self.indices)

    @property
    def systems_kept(self) -> int:
        """For how many members a process keeps a system of its own; the others share one."""
        bytes_of_one = 40 * self.indices.size  # two matrices on one pattern and the incomplete factors
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
        """Return the steps in one wind from its advection matrix; Galerkin's scheme alone, where that is all of it."""
        return self._system(advection, self._mass / self.dt, reuse)

    def advection(self, velocity: Any) -> np.ndarray:
        """Return the advection matrix of a wind as CSR values on (``indptr``, ``indices``).

        In Galerkin's scheme it is linear in the wind: the matrix of a sum of winds is the sum of their matrices.
        """
        self._velocity.interpolate(velocity)
        return self._assemble(self._advection)

    def _system(self, advection: np.ndarray, before: np.ndarray, reuse: TransportSystem | None) -> TransportSystem:
        after = before + self.options.diffusion * self._stiffness + advection
        after[self._fixed_entries] = 0.0
        after[self._fixed_diagonal] = 1.0
        system = reuse or TransportSystem(self)
        system.change(after, before)
        return system

    def _assemble(self, form: Any) -> np.ndarray:
        from dolfinx import fem

        self._workspace.data[:] = 0.0
        fem.assemble_matrix(self._workspace, form)
        return self._workspace.data.copy()


class TransportSystem:
    """Steps of the transport in one wind, its matrix and preconditioner kept: made by ``Transport.system``."""

    def __init__(self, transport: Transport):
        from petsc4py import PETSc
        from scipy.sparse import csr_matrix

        self._transport = transport
        shape = (transport.nodes, transport.nodes)
        self._before = csr_matrix((np.zeros(transport.indices.size), transport.indices, transport.indptr), shape=shape)
        self._values = np.zeros(transport.indices.size)
        self._after = PETSc.Mat().createAIJWithArrays(
            shape, (transport.indptr, transport.indices, self._values), comm=PETSc.COMM_SELF
        )
        solver: Any = PETSc.KSP().create(PETSc.COMM_SELF)
        solver.setType("bcgs")
        solver.setPCSide(PETSc.PC.Side.RIGHT)  # so that the norm watched is that of the true residual
        solver.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        solver.getPC().setType("ilu")
        solver.getPC().setFactorLevels(1)  # without fill, a strong wind can keep BiCGStab from converging
        solver.setInitialGuessNonzero(True)
        options = transport.options
        solver.setTolerances(rtol=options.tolerance, atol=0.0, max_it=options.max_iterations)
        self._solver = solver
        self._right, self._left = self._after.createVecRight(), self._after.createVecLeft()

    def change(self, after: np.ndarray, before: np.ndarray) -> None:
        """Take the CSR values of the matrices on the new (``after``) and on the old (``before``) concentration."""
        self._values[:] = after
        self._before.data[:] = before
        self._after.assemble()
        self._solver.setOperators(self._after)
        self._solver.setUp()  # what depends on the pattern alone is done the first time

    def step(self, concentration: np.ndarray, source: np.ndarray | None = None) -> np.ndarray:
        """Return the concentration (nodes,) one time step later.

        ``source`` (nodes,) is the rate f at the end of the step, in concentration per second. Raises SolverError where
        the linear solver does not reach its tolerance and ContractError where an array has another shape.
        """
        transport = self._transport
        for array in (concentration,) if source is None else (concentration, source):
            if array.shape != (transport.nodes,):
                raise ContractError(f"transport: expected {transport.nodes} nodal values, got shape {array.shape}")
        supplied = concentration if source is None else concentration + transport.dt * source
        self._left.array[:] = self._before @ supplied
        self._left.array[transport.outer] = 0.0
        self._right.array[:] = concentration
        self._right.array[transport.outer] = 0.0
        self._solver.solve(self._left, self._right)
        for _ in range(RESTARTS):
            if self._solver.getConvergedReason() != BREAKDOWN:
                break
            self._solver.solve(self._left, self._right)  # from where it came to
        reason, after = self._solver.getConvergedReason(), self._right.array.copy()
        if reason <= 0 or not np.isfinite(after).all():
            raise SolverError(
                f"transport: no convergence after {self._solver.getIterationNumber()} iterations (PETSc reason "
                f"{reason}), expected a relative residual of at most {transport.options.tolerance:.3g}"
            )
        return after
