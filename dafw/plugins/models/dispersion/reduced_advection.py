"""The advection matrix of a wind in the reduced basis: a sum of matrices that are assembled once."""

from __future__ import annotations

from typing import Any

import numpy as np

from dafw.plugins.models.dispersion.transport import Transport


class ReducedAdvection:
    """One matrix (CSR values) for each velocity of a reduced basis, in Galerkin's scheme."""

    def __init__(self, transport: Transport, solver: Any):
        """Assemble them: some milliseconds each. ``solver`` is a ``ReducedWindSolver``."""
        from dolfinx import fem

        self._trusts = solver.trusts
        velocities = solver.flow.basis.velocities
        function = fem.Function(solver.problem.velocity_space)
        self._matrices = np.empty((transport.indices.size, velocities.shape[1]), order="F")
        for column, velocity in enumerate(velocities.T):
            function.x.array[:] = velocity
            self._matrices[:, column] = transport.advection(function)

    def holds(self, unit: np.ndarray) -> bool:
        """Say whether a unit wind (n + 1,) is one of the reduced basis."""
        return bool(self._trusts(unit))

    def matrix(self, unit: np.ndarray, intensity: float) -> np.ndarray:
        """Return the CSR values for a unit wind (n + 1,) of the reduced basis and its intensity in m/s."""
        used = 1 + int(np.flatnonzero(unit[:-1])[-1])  # the first so many modes, where they did
        return self._matrices[:, :used] @ (intensity * unit[:used])
