"""The linear system of a transport step in one wind, ``solver: direct``: a sparse LU that is kept with the wind.

A wind stays the same through many steps, above all where the model is run again, so its matrix is factorised once and
a step is two triangular solves. docs/fast-winds.md, "Re-runs", has the figures.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dafw.core.errors import SolverError
from dafw.plugins.models.dispersion.fem.sparse_lu import SparseLU
from dafw.plugins.models.dispersion.transport.matrices import TransportMatrices


class DirectTransport:
    """What the direct systems of one transport share: a matrix and memory."""

    def __init__(self, matrices: TransportMatrices):
        self.matrices = matrices
        self._before = self._ordered(matrices.before)
        self.values = np.empty(matrices.sparsity.indices.size)  # of the matrix that is being factorised

    def before(self, before: Any) -> Any:
        """Return the matrix on the old concentration with its rows in the order of elimination, zero at fixed nodes."""
        return self._before if before is self.matrices.before else self._ordered(before)

    def _ordered(self, before: Any) -> Any:
        inner = np.ones(self.matrices.nodes)
        inner[self.matrices.fixed] = 0.0
        values = before.data * np.repeat(inner, np.diff(before.indptr))
        return self.matrices.sparsity.csr(values)[self.matrices.elimination.order]


class DirectSystem:
    """The factorised matrix of a step in one wind; ``Transport.system`` makes it."""

    def __init__(self, shared: DirectTransport):
        self._shared = shared
        self._before: Any = None
        self._after = SparseLU(shared.matrices.elimination)

    def change(self, added: np.ndarray, before: Any) -> None:
        """Set the system to that of another wind.

        Args:
            added: (z,) CSR values that the wind adds to the matrix on the new concentration.
            before: the SciPy matrix on the old concentration.

        Raises SolverError if the matrix is singular or cannot be factorised without pivoting.
        """
        self._before = self._shared.before(before)
        values = self._shared.matrices.after(added, self._shared.values)
        try:
            self._after.factorise(values)
        except SolverError as error:
            raise SolverError(f"transport: {error}; use transport.solver=iterative") from error

    def step(self, concentration: np.ndarray, source: np.ndarray | None = None) -> np.ndarray:
        """Return the concentration (nodes,) one time step later.

        Args:
            concentration: (nodes,) at the start of the step.
            source: (nodes,) rate f at the end of the step, in concentration per second; None is no source.

        Raises ContractError if an array has another shape, and SolverError if the result is not finite.
        """
        left = self._before @ self._shared.matrices.supplied(concentration, source)
        return self._after.solve_ordered(left)[self._shared.matrices.elimination.places]
