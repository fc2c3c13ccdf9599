"""Transport of a gas by a given wind: advection and diffusion, P1 finite elements, backward Euler.

    dc/dt + w . grad c - epsilon lap c = f,    c = 0 on the outer boundary,    dc/dn = 0 on walls

Gioia et al. 2024, equations (AD) and (W-AD), doi:10.1109/SDF63218.2024.10773899; docs/physics.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dafw.core.options import option
from dafw.plugins.models.dispersion.mesh import OUTER, TaggedMesh
from dafw.plugins.models.dispersion.transport_system import TransportSystem

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
        outer = fem.locate_dofs_topological(self._space, mesh.topology.dim - 1, tagged_mesh.facet_tags.find(OUTER))
        self.outer = outer[outer < self.nodes]
        fixed = np.zeros(self.nodes, dtype=bool)
        fixed[self.outer] = True
        self.row_starts, self.diagonal = self.indptr[:-1].astype(np.intp), np.flatnonzero(rows == self.indices)
        self.fixed_entries = np.flatnonzero(fixed[rows] | self.sparsity.with_ghosts(fixed)[self.indices])
        self.fixed_diagonal = self.diagonal[self.outer]
        # of a step without wind: the matrices on the old and on the new concentration
        self._before = self.sparsity.csr(self._assemble(mass) / dt)
        self.calm = self._before.data + options.diffusion * self._assemble(stiffness)

    @property
    def systems_kept(self) -> int:
        """For how many members a process keeps a system of its own; the others share one."""
        # measured: 40 after weak winds, 70 to 110 after stronger ones, too, 100 after strong ones, 160 after all
        bytes_of_one = 100 * self.indices.size
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
        advected_mass = self._assemble(self._advected_mass) / self.dt
        before = self.sparsity.csr(self._before.data + advected_mass)
        return self._system(advection + advected_mass, before, reuse)

    def system_of(self, advection: np.ndarray, reuse: TransportSystem | None = None) -> TransportSystem:
        """Return the steps in one wind from its advection matrix; in Galerkin's scheme that is all there is of it."""
        return self._system(advection, self._before, reuse)

    def advection(self, velocity: Any) -> np.ndarray:
        """Return the advection matrix of a wind as CSR values on (``indptr``, ``indices``).

        In Galerkin's scheme it is linear in the wind: the matrix of a sum of winds is the sum of their matrices.
        """
        self._velocity.interpolate(velocity)
        self._velocity.x.scatter_forward()
        return self._assemble(self._advection)

    def _system(self, added: np.ndarray, before: Any, reuse: TransportSystem | None) -> TransportSystem:
        system = reuse or TransportSystem(self)
        system.change(added, before)
        return system

    def _assemble(self, form: Any) -> np.ndarray:
        return self.sparsity.assemble(form).copy()
