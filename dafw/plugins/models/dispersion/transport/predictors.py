"""The two solutions that a flux-corrected step is made of, Galerkin's and that of low order (flux_corrected.py)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from dafw.core.errors import SolverError
from dafw.plugins.models.dispersion.fem.paired_lu import PairedLU
from dafw.plugins.models.dispersion.fem.sparse_lu import SparseLU
from dafw.plugins.models.dispersion.transport.matrices import TransportMatrices


class DirectPredictors:
    """``solver: direct``: both matrices are factorised together."""

    def __init__(self, matrices: TransportMatrices, lumped: np.ndarray):
        """Prepare the systems.

        Args:
            matrices: those of the transport.
            lumped: (nodes,) lumped mass over the time step, zero at fixed nodes.
        """
        self._matrices, self._lumped = matrices, lumped
        self._factors = PairedLU(matrices.elimination)
        self._own, self._between = matrices.before.data[matrices.diagonal], matrices.before.data[matrices.edges.there]

    def change(self, added: np.ndarray, before: Any, low_order: np.ndarray) -> None:
        """Set the systems to those of another wind.

        Args:
            added: (z,) CSR values that the wind adds to Galerkin's matrix on the new concentration.
            before: the SciPy matrix on the old concentration, that of ``matrices``.
            low_order: (z,) CSR values of the matrix of low order.

        Raises SolverError if a matrix is singular or cannot be factorised without pivoting.
        """
        try:
            self._factors.factorise(self._matrices.after(added, np.empty(added.size)), low_order)
        except SolverError as error:
            raise SolverError(f"transport: {error}; use transport.solver=iterative") from error

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
        edges = self._matrices.edges
        given = right_sides(edges.starts, edges.second, self._own, self._between, self._lumped, supplied)
        return self._factors.solve(*given)


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
        """Return both solutions; arguments and errors are those of ``DirectPredictors``."""
        high = self._galerkin.step(concentration, source)
        return high, self._low_order.solve(self._lumped * supplied)


@njit(cache=True)
def right_sides(
    starts: np.ndarray,
    second: np.ndarray,
    own: np.ndarray,
    between: np.ndarray,
    lumped: np.ndarray,
    supplied: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the right-hand sides (n,) of Galerkin's system and of that of low order, zero at fixed nodes.

    Along the edges, since the limiter reads them as well: the mass matrix would take a part of the processor's cache,
    and a step 7 % more time.

    Args:
        starts: (n + 1,) that of ``Edges``.
        second: (e,) that of ``Edges``.
        own: (n,) entries of the mass matrix on the diagonal, over the time step.
        between: (e,) its entries between the nodes of every edge, over the time step.
        lumped: (n,) lumped mass over the time step, zero at fixed nodes.
        supplied: (n,) concentration at the start, with what the source adds in the step.
    """
    given, given_lumped = own * supplied, lumped * supplied
    for i in range(supplied.size):
        for edge in range(starts[i], starts[i + 1]):
            j = second[edge]
            given[i] += between[edge] * supplied[j]
            given[j] += between[edge] * supplied[i]
    for i in range(supplied.size):
        if lumped[i] == 0.0:
            given[i] = 0.0
    return given, given_lumped
