"""The advection matrix of a wind in the reduced basis: a sum of matrices that are assembled once.

The time of the sum is that of reading the matrices, so the modes that are a small part of any wind are kept in single
precision. The diagonal is set right by what is known exactly, that rows sum to zero: round-off then acts on differences
of neighbouring concentrations and not on the concentrations.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dafw.plugins.models.dispersion.transport import Transport

ACCEPTED = 1e-8
"""Concentrations then agree to less than that of the largest one: docs/fast-winds.md."""
COLUMNS = 4
"""BLAS adds up so many columns at a time; one, two or three more take longer than four."""


class ReducedAdvection:
    """One matrix (CSR values) for each velocity of a reduced basis, in Galerkin's scheme.

    Attributes:
        leading: how many of them, from the first on, are in double precision.
    """

    def __init__(self, transport: Transport, solver: Any, accepted: float = ACCEPTED):
        """Assemble them: some milliseconds each. ``solver`` is a ``ReducedWindSolver``.

        Velocities are in single precision from where on the round-off of each, at the largest coefficient of any
        snapshot, is at most ``accepted`` of the largest entry of the two Stokes flows.
        """
        from dolfinx import fem

        self._trusts = solver.trusts
        self._row_starts, self._diagonal = transport.row_starts, transport.diagonal
        basis = solver.flow.basis
        function = fem.Function(solver.problem.velocity_space)
        matrices = np.empty((transport.indices.size, basis.velocities.shape[1]), order="F")
        for column, velocity in enumerate(basis.velocities.T):
            function.x.array[:] = velocity
            matrices[:, column] = transport.advection(function)
        largest = np.maximum(matrices.max(axis=0), -matrices.min(axis=0))
        largest[2:] *= np.abs(basis.coefficients).max(axis=0)
        rounded = np.finfo(np.float32).epsneg * largest
        self.leading = leading = whole(1 + int(np.flatnonzero(rounded > accepted * largest[:2].max())[-1]))
        self._double = matrices[:, :leading].copy(order="F")
        # the last first: what is summed up in single precision stays small for as long as can be
        self._single = matrices[:, : leading - 1 : -1].astype(np.float32, order="F")

    def holds(self, unit: np.ndarray) -> bool:
        """Say whether a unit wind (n + 1,) is one of the reduced basis."""
        return bool(self._trusts(unit))

    def matrix(self, unit: np.ndarray, intensity: float) -> np.ndarray:
        """Return the CSR values for a unit wind (n + 1,) of the reduced basis and its intensity in m/s."""
        used = whole(1 + int(np.flatnonzero(unit[:-1])[-1]))  # the first so many modes, where they did
        leading, others = np.split(intensity * unit[:-1][:used], [self.leading])
        values: np.ndarray = self._double[:, : leading.size] @ leading
        values += self._single[:, self._single.shape[1] - others.size :] @ others[::-1].astype(np.float32)
        values[self._diagonal] -= np.add.reduceat(values, self._row_starts)
        return values


def whole(columns: int) -> int:
    """Return the next multiple of ``COLUMNS``."""
    return -(-columns // COLUMNS) * COLUMNS
