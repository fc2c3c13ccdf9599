"""The two solutions that a flux-corrected step is made of, Galerkin's and that of low order (flux_corrected.py)."""

from __future__ import annotations

from typing import Any

import numpy as np

from dafw.core.errors import SolverError
from dafw.plugins.models.dispersion.fem.paired_lu import PairedLU
from dafw.plugins.models.dispersion.fem.sparse_lu import SparseLU
from dafw.plugins.models.dispersion.transport.matrices import TransportMatrices


class DirectPredictors:
    """``solver: direct``: both matrices are factorised together. march.py uses the factors.

    Attributes:
        lumped: (nodes,) lumped mass over the time step, zero at fixed nodes.
        factors: the factorised matrices.
        own: (nodes,) entries of the mass matrix on the diagonal, over the time step.
        between: (e,) its entries between the nodes of every edge, over the time step.
    """

    def __init__(self, matrices: TransportMatrices, lumped: np.ndarray):
        """Prepare the systems.

        Args:
            matrices: those of the transport.
            lumped: (nodes,) lumped mass over the time step, zero at fixed nodes.
        """
        self._matrices, self.lumped = matrices, lumped
        self.factors = PairedLU(matrices.elimination)
        self.own, self.between = matrices.before.data[matrices.diagonal], matrices.before.data[matrices.edges.there]

    def change(self, added: np.ndarray, before: Any, low_order: np.ndarray) -> None:
        """Set the systems to those of another wind.

        Args:
            added: (z,) CSR values that the wind adds to Galerkin's matrix on the new concentration.
            before: the SciPy matrix on the old concentration, that of ``matrices``.
            low_order: (z,) CSR values of the matrix of low order.

        Raises SolverError if a matrix is singular or cannot be factorised without pivoting.
        """
        try:
            self.factors.factorise(self._matrices.after(added, np.empty(added.size)), low_order)
        except SolverError as error:
            raise SolverError(f"transport: {error}; use transport.solver=iterative") from error


class IterativePredictors:
    """``solver: iterative`` for Galerkin's solution; that of low order has a factorisation of its own."""

    def __init__(self, matrices: TransportMatrices, lumped: np.ndarray, galerkin: Any):
        """Prepare the systems.

        Args:
            matrices: as for ``DirectPredictors``.
            lumped: as for ``DirectPredictors``.
            galerkin: the ``TransportSystem`` of Galerkin's step, which nothing else uses.
        """
        self._matrices, self._lumped = matrices, lumped
        self._galerkin, self._low_order = galerkin, SparseLU(matrices.elimination)

    def change(self, added: np.ndarray, before: Any, low_order: np.ndarray) -> None:
        """Set the systems to those of another wind; arguments and errors are those of ``DirectPredictors``."""
        self._galerkin.change(added, before)
        self._low_order.factorise(low_order)

    def solve(
        self, supplied: np.ndarray, concentration: np.ndarray, source: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return Galerkin's solution and that of low order at the end of a step, (nodes,) each.

        Args:
            supplied: (nodes,) concentration at the start of the step, with what the source adds.
            concentration: (nodes,) that without it.
            source: (nodes,) rate f at the end of the step, in concentration per second; None is no source.

        Raises SolverError if a system cannot be solved or a solution is not finite.
        """
        high = self._galerkin.step(concentration, source)
        return high, self._low_order.solve(self._lumped * supplied)
