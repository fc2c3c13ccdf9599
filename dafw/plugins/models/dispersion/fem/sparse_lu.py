"""Sparse LU factorisations of many matrices that share one sparsity pattern, in one process and without pivoting.

The order of elimination is found once for the pattern: minimum degree on A + A^T (Liu 1985, doi:10.1145/214392.214398),
as SuperLU finds it. Every matrix is permuted by it and factorised by PETSc's own LU; docs/fast-winds.md, "Re-runs", has
the times of this and of other libraries.

Without pivoting a factorisation can lose digits. So each is tried on a fixed right-hand side before it is used, and
refused if the matrix is singular or the residual too large. That depends on the matrix alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, tril
from scipy.sparse.linalg import splu

from dafw.core.errors import SolverError

# isort: split
from petsc4py import PETSc

TOLERANCE = 1e-12
"""Largest accepted residual when a factorisation is tried, relative to |A| |x| + |b| (maximum norms)."""
SINGULAR = 1e13
"""From this |A| |x| / |b| on, a matrix counts as singular: fewer than three digits of a solution would be right."""


@dataclass(frozen=True)
class Fill:
    """Where the factors of a pattern have entries: the rows of L, by columns, which are the columns of U, by rows.

    Indices are of type uint32: numba then does not look for negative ones.

    Attributes:
        starts: (n + 1,) the rows of column k of L below the diagonal are ``rows[starts[k]:starts[k + 1]]``.
        rows: (f,) all of them, in ascending order in every column.
        below: (b,) index in ``rows`` of every entry of the pattern below the diagonal.
        above: (b,) likewise of every entry above it.
        diagonal: (n,) row of every entry of the diagonal.
        below_entries: (b,) index, in the pattern that was given, of every entry below the diagonal.
        above_entries: (b,) likewise above it.
        diagonal_entries: (n,) likewise on it.
    """

    starts: np.ndarray
    rows: np.ndarray
    below: np.ndarray
    above: np.ndarray
    diagonal: np.ndarray
    below_entries: np.ndarray
    above_entries: np.ndarray
    diagonal_entries: np.ndarray


class Elimination:
    """The order in which the unknowns of one sparsity pattern are eliminated.

    Attributes:
        order: (n,) the unknowns in this order.
        places: (n,) the place of every unknown in the order.
        indptr: (n + 1,) start of every row of the permuted pattern, CSR.
        indices: (z,) column of every entry of the permuted pattern, CSR.
        entries: (z,) index, in the pattern that was given, of every entry of the permuted one.
        signs: (n,) a right-hand side of random signs, always the same, on which factorisations are tried.
        fill: where factors have entries.
    """

    def __init__(self, indptr: np.ndarray, indices: np.ndarray):
        """Find the order.

        Args:
            indptr: (n + 1,) start of every row, CSR.
            indices: (z,) column of every entry, CSR. The pattern is symmetric and has the whole diagonal.
        """
        n = indptr.size - 1
        rows = np.repeat(np.arange(n), np.diff(indptr))
        # Any diagonally dominant matrix of the pattern will do: the order depends on the pattern alone. If the diagonal
        # were much larger, small entries of L would be rounded to zero and missing in the fill.
        values = np.where(rows == indices, np.diff(indptr)[rows].astype(float), -1.0)
        pattern = csr_matrix((values, indices, indptr), shape=(n, n)).tocsc()
        options = {"SymmetricMode": True, "Equil": False}
        factors = splu(pattern, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        self.places = factors.perm_c.astype(np.intp)
        self.order: np.ndarray = np.argsort(self.places)
        permuted = csr_matrix((np.arange(indices.size), indices, indptr), shape=(n, n))[self.order][:, self.order]
        permuted.sort_indices()
        self.indptr, self.indices = permuted.indptr.astype(np.int32), permuted.indices.astype(np.int32)
        self.entries: np.ndarray = permuted.data
        # Without structure, so that it shows how large the inverse of a matrix is.
        self.signs = np.where(np.random.default_rng(0).random(n) < 0.5, -1.0, 1.0)
        self.fill = self._fill(tril(factors.L, -1).tocsc())

    def _fill(self, lower: Any) -> Fill:
        lower.sort_indices()
        n = self.order.size
        columns = np.repeat(np.arange(n), np.diff(lower.indptr))
        position = columns * n + lower.indices  # in ascending order
        i, j = np.repeat(np.arange(n), np.diff(self.indptr)), self.indices.astype(np.int64)
        under, over = i > j, i < j
        return Fill(
            lower.indptr.astype(np.uint32),
            lower.indices.astype(np.uint32),
            np.searchsorted(position, (j * n + i)[under]).astype(np.uint32),
            np.searchsorted(position, (i * n + j)[over]).astype(np.uint32),
            np.arange(n, dtype=np.uint32),
            *(self.entries[part].astype(np.uint32) for part in (under, over, i == j)),
        )

    def ordered(self, values: np.ndarray) -> Any:
        """Return the SciPy matrix, in the order of elimination, with the CSR values (z,) of the pattern given."""
        n = self.order.size
        return csr_matrix((values[self.entries], self.indices, self.indptr), shape=(n, n))


class SparseLU:
    """One factorised matrix of the pattern of an ``Elimination``.

    To factorise another matrix with the same object takes half the time of the first.
    """

    def __init__(self, elimination: Elimination):
        n = elimination.order.size
        self._elimination = elimination
        self._values = np.zeros(elimination.entries.size)
        rows = (elimination.indptr, elimination.indices, self._values)
        self._matrix = PETSc.Mat().createAIJWithArrays((n, n), rows, comm=PETSc.COMM_SELF)
        self._solver = PETSc.PC().create(PETSc.COMM_SELF)
        self._solver.setType("lu")
        self._solver.setFactorSolverType("petsc")
        self._solver.setFactorOrdering("natural")
        self._solver.setFactorPivot(zeropivot=0.0)  # PETSc's own bound is absolute, so it depends on the units
        self._left, self._right = np.zeros(n), np.zeros(n)
        self._left_vector, self._right_vector = _vector(self._left), _vector(self._right)
        self._ordered = csr_matrix((self._values, elimination.indices, elimination.indptr), shape=(n, n))
        self._factors: Any = None

    def factorise(self, values: np.ndarray) -> None:
        """Factorise a matrix and try the factors.

        Args:
            values: (z,) CSR values of the matrix, in the pattern that the elimination was made from.

        Raises SolverError if the matrix is singular or cannot be factorised without pivoting.
        """
        self._factors = None
        self._values[:] = values[self._elimination.entries]
        self._matrix.assemble()
        self._solver.setOperators(self._matrix)
        self._solver.setUp()
        if self._solver.getFailedReason():
            raise SolverError("sparse LU: the matrix is singular or cannot do without pivoting: a pivot is zero")
        self._factors = self._solver.getFactorMatrix()
        try:
            self._try()
        except SolverError:
            self._factors = None
            raise

    def _try(self) -> None:
        """Raise SolverError unless a system with a right-hand side b of random signs is solved well enough."""
        self._left[:] = right = self._elimination.signs
        self._factors.solve(self._left_vector, self._right_vector)
        require_accurate(self._ordered, self._right, right)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return the solution for one right-hand side (n,) or for several (n, k), in the same shape."""
        if right.ndim == 2:
            return np.stack([self.solve(column) for column in right.T], axis=1)
        return self.solve_ordered(right[self._elimination.order])[self._elimination.places]

    def solve_ordered(self, right: np.ndarray) -> np.ndarray:
        """Return the solution (n,) for a right-hand side (n,), both in the order of elimination.

        The result is a view that the next call overwrites. Raises SolverError if nothing is factorised, or if the
        solution is not finite.
        """
        if self._factors is None:
            raise SolverError("sparse LU: there is no factorisation, or the last one failed")
        self._left[:] = right
        self._factors.solve(self._left_vector, self._right_vector)
        if not math.isfinite(self._right.sum()):
            raise SolverError("sparse LU: a solution is not finite")
        return self._right


def require_accurate(matrix: Any, solution: np.ndarray, right: np.ndarray) -> None:
    """Raise SolverError unless a solution (n,) for a right-hand side (n,) of random signs is good enough."""
    size = np.add.reduceat(np.abs(matrix.data), matrix.indptr[:-1]).max() * np.abs(solution).max()
    if not size <= SINGULAR:
        raise SolverError(
            f"sparse LU: the matrix is singular to working precision: |A| |x| / |b| is {size:.3g}, expected "
            f"at most {SINGULAR:.3g}"
        )
    residual = np.abs(matrix @ solution - right).max()
    if not residual <= TOLERANCE * (size + 1.0):
        raise SolverError(
            f"sparse LU: without pivoting a residual of {residual:.3g} is left, expected at most "
            f"{TOLERANCE:.3g} times {size + 1.0:.3g}"
        )


def _vector(values: np.ndarray) -> Any:
    """Return a PETSc vector that shares its memory with ``values`` (n,)."""
    create: Any = PETSc.Vec().createWithArray  # its annotation does not know arrays
    return create(values, comm=PETSc.COMM_SELF)
