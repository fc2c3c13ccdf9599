"""Transport of a gas by a given wind: advection and diffusion, P1 finite elements, backward Euler.

    dc/dt + w . grad c - epsilon lap c = f,    c = 0 on the outer boundary,    dc/dn = 0 on walls

Gioia et al. 2024, equations (AD) and (W-AD), doi:10.1109/SDF63218.2024.10773899; docs/physics.md.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from dafw.plugins.models.dispersion.fem.sparsity import total
from dafw.plugins.models.dispersion.mesh.tagged import TaggedMesh
from dafw.plugins.models.dispersion.transport.direct import DirectSystem, DirectTransport
from dafw.plugins.models.dispersion.transport.matrices import TransportMatrices
from dafw.plugins.models.dispersion.transport.options import TransportOptions
from dafw.plugins.models.dispersion.transport.system import TransportSystem

# isort: split
import ufl
from dolfinx import fem

if TYPE_CHECKING:
    from dafw.plugins.models.dispersion.transport.flux_corrected import FluxCorrectedSystem

SYSTEMS_BYTES = 2e9
"""About how much memory, in bytes, the systems of all members may take in one process."""

BYTES_PER_ENTRY = {"iterative": 100, "direct": 100}
"""Memory of one system in bytes per entry of its matrix, by solver; an iterative one has another 100 with ``fct``.

Measured, iterative: 40 after weak winds alone (ILU(0)), 70 to 110 after medium winds, too (ILU(1)), 100 after strong
winds alone (LU), 160 after winds of all kinds. Direct: 60 on 2,715 nodes, 90 on 10,045; with ``fct``, whose two
matrices share their indices, 80 and 110.
"""

LEAST_KEPT = {"iterative": 2, "direct": 64}
"""This many systems are kept even where few members are stepped together, by solver, memory allowing; else two for each
member.

To make a system over takes half the time of making a new one, and a run in which winds change often takes 12 % longer
without making over. So no more are kept than are likely to be used again. With factors that serve any number of steps,
these are those of a belief or of the particles of a sampler, and those of the members that are run again meanwhile. An
iterative system is needed by the next step or by none. If 64 were kept, the steps of the paper's study would take 5 %
longer, because each would begin in slow memory.
"""

type System = TransportSystem | DirectSystem | FluxCorrectedSystem
"""The system of a step in one wind, of whatever scheme."""


class Transport:
    """Makes the systems of equations of a step, for any wind on one mesh.

    On a mesh that is divided among several ranks all methods are collective calls, and arrays hold the nodes that the
    rank owns.

    Attributes:
        matrices: what does not depend on the wind.
    """

    def __init__(self, tagged_mesh: TaggedMesh, options: TransportOptions, dt: float):
        """Assemble what does not depend on the wind.

        Args:
            tagged_mesh: the mesh.
            options: the options of the transport.
            dt: time step in s.
        """
        mesh = tagged_mesh.mesh
        self.matrices = TransportMatrices(tagged_mesh, options, dt)
        velocity_space = fem.functionspace(mesh, ("Lagrange", 2, (mesh.geometry.dim,)))
        self._velocity = w = fem.Function(velocity_space)

        c, v = ufl.TrialFunction(self.matrices.space), ufl.TestFunction(self.matrices.space)
        advected = ufl.dot(w, ufl.grad(c))
        self._advection, self._advected_mass = fem.form(advected * v * ufl.dx), None
        if options.scheme == "supg":
            weight = self._intrinsic_time(mesh) * ufl.dot(w, ufl.grad(v))
            # Degree 4 integrates the products exactly; the intrinsic time is not a polynomial.
            measure = ufl.dx(metadata={"quadrature_degree": 4})
            self._advection = fem.form(advected * v * ufl.dx + advected * weight * measure)
            self._advected_mass = fem.form(c * weight * measure)

    def systems_kept(self, members: int) -> int:
        """Return how many systems a process keeps if it steps so many members together; the same on all ranks."""
        options = self.matrices.options
        separate = options.scheme == "fct" and options.solver == "iterative"
        per_entry = BYTES_PER_ENTRY[options.solver] + (BYTES_PER_ENTRY["direct"] if separate else 0)
        affordable = int(SYSTEMS_BYTES / (per_entry * self._entries))
        return max(1, min(affordable, max(LEAST_KEPT[options.solver], 2 * members)))

    def _intrinsic_time(self, mesh: Any) -> Any:
        """Return the time scale of SUPG; Shakib et al. 1991, doi:10.1016/0045-7825(91)90041-4, with element metric."""
        # The metric G has the unit 1/m^2: for a unit vector a and an element of length h, a . G a is about 1 / h^2.
        inverse = ufl.JacobianInverse(mesh)
        metric = ufl.dot(inverse.T, inverse)
        along = ufl.dot(self._velocity, ufl.dot(metric, self._velocity))
        across = self.matrices.options.diffusion**2 * ufl.inner(metric, metric)
        return 1.0 / ufl.sqrt((2.0 / self.matrices.dt) ** 2 + 4.0 * along + 72.0 * across)

    def uniform_velocity(self, intensity: float, direction: float) -> Any:
        """Return a wind that is the same everywhere, as a DOLFINx function in m/s.

        Args:
            intensity: in m/s.
            direction: towards which the air moves, in radians.
        """
        function = fem.Function(self._velocity.function_space)
        function.x.array.reshape(-1, 2)[:] = intensity * np.array([np.cos(direction), np.sin(direction)])
        return function

    def system(self, velocity: Any, reuse: System | None = None, *, diffusion: float | None = None) -> System:
        """Return the system of a step in one wind.

        Args:
            velocity: the wind in m/s, a DOLFINx vector function of the mesh, P2 or of lower degree.
            reuse: a system of this transport that is no longer needed. It is overwritten and returned, which takes
                half the time of making a new one. Without reuse a whole run takes 12 % longer.
            diffusion: coefficient in m^2/s; None is that of the options, which SUPG insists on.
        """
        advection = self.advection(velocity)
        if self._advected_mass is None:
            return self.system_of(advection, reuse, diffusion=diffusion)
        matrices = self.matrices
        advected_mass = matrices.assemble(self._advected_mass) / matrices.dt
        before = matrices.sparsity.csr(matrices.before.data + advected_mass)
        return self._system(self._without_inflow(advection) + advected_mass, before, reuse)

    def system_of(
        self, advection: np.ndarray, reuse: System | None = None, *, diffusion: float | None = None
    ) -> System:
        """Return the system of a step in one wind, for Galerkin's scheme and for flux-corrected transport.

        Args:
            advection: (z,) CSR values of the advection matrix of the wind.
            reuse: as for ``system``.
            diffusion: as for ``system``.
        """
        matrices, added = self.matrices, self._without_inflow(advection)
        if diffusion is not None and diffusion != matrices.options.diffusion:
            added = added + (diffusion - matrices.options.diffusion) * matrices.stiffness
        return self._system(added, matrices.before, reuse)

    def _without_inflow(self, advection: np.ndarray) -> np.ndarray:
        """Return the CSR values (z,) of the advection with an open boundary: where the wind enters it brings no gas."""
        matrices = self.matrices
        if matrices.options.outflow == "zero":
            return advection
        open_advection = advection.copy()
        open_advection[matrices.diagonal[matrices.outer]] += np.maximum(-matrices.outward(advection), 0.0)
        return open_advection

    def advection(self, velocity: Any) -> np.ndarray:
        """Return the CSR values (z,) of the advection matrix of a wind; ``velocity`` is as for ``system``.

        In Galerkin's scheme it is linear in the wind: the matrix of a sum of winds is the sum of their matrices.
        """
        self._velocity.interpolate(velocity)
        self._velocity.x.scatter_forward()
        return self.matrices.assemble(self._advection)

    def _system(self, added: np.ndarray, before: Any, reuse: System | None) -> System:
        system = reuse or self._new_system()
        system.change(added, before)
        return system

    def _new_system(self) -> System:
        options = self.matrices.options
        iterative = TransportSystem(self.matrices) if options.solver == "iterative" else None
        if options.scheme == "fct":
            # Here, because it imports numba, which takes most of a second.
            from dafw.plugins.models.dispersion.transport.flux_corrected import FluxCorrectedSystem

            return FluxCorrectedSystem(self.matrices, iterative)
        return iterative or DirectSystem(self._direct)

    @cached_property
    def _direct(self) -> DirectTransport:
        return DirectTransport(self.matrices)

    @cached_property
    def _entries(self) -> float:
        """The number of entries of a matrix, on each rank on average."""
        sparsity = self.matrices.sparsity
        return float(total(sparsity.comm, sparsity.indices.size) / sparsity.comm.size)
