"""The advection matrix of a wind in the reduced basis: a sum of matrices that are assembled once.

The sum takes as long as reading the matrices. Therefore the matrices of modes that are a small part of every wind are
kept in single precision; in double precision a whole run would take 7 % longer. The diagonal is set so that every row
sums to zero, as it does exactly. Round-off then acts on differences of neighbouring concentrations, not on the
concentrations.
"""

from __future__ import annotations

import numpy as np

from dafw.plugins.models.dispersion.reduced_wind.reduced import ReducedWindSolver
from dafw.plugins.models.dispersion.transport.transport import Transport

# isort: split
from dolfinx import fem

ACCEPTED = 1e-8
"""Accepted round-off; concentrations then differ by less than this part of the largest one: docs/fast-winds.md."""
COLUMNS = 4
"""The number of matrices of either precision is a multiple of this, the number of columns that BLAS adds at a time.

A whole run does not notice it (2 %, within the scatter), but without it the last bits of runs would change.
"""


class ReducedAdvection:
    """One matrix (CSR values) for each velocity of a reduced basis, in Galerkin's scheme.

    Attributes:
        leading: how many matrices, from the first on, are in double precision.
    """

    def __init__(self, transport: Transport, solver: ReducedWindSolver, accepted: float = ACCEPTED):
        """Assemble the matrices, which takes some milliseconds each.

        A matrix is in single precision if its round-off, at the largest coefficient of any snapshot, is at most
        ``accepted`` times the largest entry of the matrices of the two Stokes flows; and so are all after it.

        Args:
            transport: makes the advection matrix of one velocity.
            solver: its basis is used.
            accepted: relative round-off that is accepted.
        """
        self._trusts = solver.trusts
        self._row_starts, self._diagonal = transport.matrices.row_starts, transport.matrices.diagonal
        basis = solver.flow.basis
        function = fem.Function(solver.problem.velocity_space)
        entries = transport.matrices.sparsity.indices.size
        matrices = np.empty((entries, basis.velocities.shape[1]), order="F")
        for column, velocity in enumerate(basis.velocities.T):
            function.x.array[:] = velocity
            matrices[:, column] = transport.advection(function)
        largest = np.maximum(matrices.max(axis=0), -matrices.min(axis=0))
        largest[2:] *= np.abs(basis.coefficients).max(axis=0)
        rounded = np.finfo(np.float32).epsneg * largest
        needed = 1 + int(np.flatnonzero(rounded > accepted * largest[:2].max())[-1])
        self.leading = leading = next_multiple(needed)
        self._double = matrices[:, :leading].copy(order="F")
        # In reversed order, so that the sum in single precision begins with the smallest matrices and stays small.
        self._single = matrices[:, : leading - 1 : -1].astype(np.float32, order="F")

    def holds(self, unit: np.ndarray) -> bool:
        """Say whether a unit wind (n + 1,) is one of the reduced basis."""
        return bool(self._trusts(unit))

    def matrix(self, unit: np.ndarray, intensity: float) -> np.ndarray:
        """Return the CSR values (z,) of the advection matrix of a wind.

        Args:
            unit: (n + 1,) a unit wind of the reduced basis.
            intensity: in m/s.
        """
        used = next_multiple(1 + int(np.flatnonzero(unit[:-1])[-1]))  # later modes have zero coefficients
        leading, others = np.split(intensity * unit[:-1][:used], [self.leading])
        values: np.ndarray = self._double[:, : leading.size] @ leading
        values += self._single[:, self._single.shape[1] - others.size :] @ others[::-1].astype(np.float32)
        values[self._diagonal] -= np.add.reduceat(values, self._row_starts)
        return values


def next_multiple(columns: int) -> int:
    """Return the smallest multiple of ``COLUMNS`` that is at least ``columns``."""
    return -(-columns // COLUMNS) * COLUMNS
