"""Sparse LU factorisations of two matrices with one sparsity pattern at once, without pivoting.

A triangular solve takes as long as reading the factors. Here one index serves four numbers, an entry of L and of U of
both matrices, and the sums of the two do not wait for each other. So two solves take 0.8 times as long as two of
sparse_lu.py, whose factors are larger, and leave more of the processor's cache to the rest of a step
(docs/fast-winds.md, "Re-runs"). In order of elimination, with R_k the rows below the diagonal of column k of
L, which are also the columns of row k of U::

    for all k:   u_kk = a_kk - sum_j l_kj u_jk                                  over all j < k with k in R_j
                 u_ki = a_ki - sum_j l_kj u_ji,   l_ik = (a_ik - sum_j l_ij u_jk) / u_kk       for all i in R_k

That is Crout's order; a list of the j for every k as in Li, Saad and Chow 2003, doi:10.1137/S1064827502405094.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from dafw.core.errors import SolverError
from dafw.plugins.models.dispersion.fem.sparse_lu import Elimination, require_accurate


class PairedLU:
    """Two factorised matrices of the pattern of an ``Elimination``.

    Attributes:
        lower: (f, 2) entries of both L below the diagonal, column by column.
        upper: (f, 2) entries of both U above the diagonal, row by row.
        inverse: (n, 2) one over the diagonal entries of both U.
    """

    def __init__(self, elimination: Elimination):
        fill = elimination.fill
        self._elimination, self._valid = elimination, False
        self.lower, self.upper = np.zeros((2, fill.rows.size, 2))
        self.inverse = np.zeros((elimination.order.size, 2))

    def factorise(self, first: np.ndarray, second: np.ndarray) -> None:
        """Factorise two matrices and try the factors.

        Args:
            first: (z,) CSR values of one matrix, in the pattern that the elimination was made from.
            second: (z,) those of the other.

        Raises SolverError if one is singular or cannot be factorised without pivoting.
        """
        self._valid = False
        elimination, fill = self._elimination, self._elimination.fill
        for entries, where, found in (
            (self.lower, fill.below, fill.below_entries),
            (self.upper, fill.above, fill.above_entries),
            (self.inverse, fill.diagonal, fill.diagonal_entries),
        ):
            spread(first, second, found, where, entries)
        if not factorise(fill.starts, fill.rows, self.lower, self.upper, self.inverse):
            raise SolverError("sparse LU: a matrix is singular or cannot do without pivoting: a pivot is zero")
        right = elimination.signs[elimination.places]
        for values, solution in zip((first, second), self._solved(right, right), strict=True):
            require_accurate(elimination.ordered(values), solution[elimination.order], elimination.signs)
        self._valid = True

    def require_valid(self) -> None:
        """Raise SolverError if nothing is factorised."""
        if not self._valid:
            raise SolverError("sparse LU: there is no factorisation, or the last one failed")

    def solve(self, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the solutions (n,) with both matrices, each for its own right-hand side (n,).

        Raises SolverError if nothing is factorised, or if a solution is not finite.
        """
        self.require_valid()
        solutions = self._solved(first, second)
        if not math.isfinite(solutions[0].sum() + solutions[1].sum()):
            raise SolverError("sparse LU: a solution is not finite")
        return solutions

    def _solved(self, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        fill, places = self._elimination.fill, self._elimination.places
        found: tuple[np.ndarray, np.ndarray] = solve(
            fill.starts, fill.rows, self.lower, self.upper, self.inverse, places, first, second
        )
        return found


@njit(cache=True, nogil=True)
def spread(first: np.ndarray, second: np.ndarray, found: np.ndarray, where: np.ndarray, entries: np.ndarray) -> None:
    """Overwrite ``entries`` (f, 2) with the values ``found`` (b,) of two matrices (z,), ``where`` (b,) it says."""
    entries[:] = 0.0
    for k in range(found.size):
        entries[where[k], 0], entries[where[k], 1] = first[found[k]], second[found[k]]


@njit(cache=True, nogil=True)
def factorise(starts: np.ndarray, rows: np.ndarray, lower: np.ndarray, upper: np.ndarray, diagonal: np.ndarray) -> bool:
    """Replace the entries of two matrices by those of their factors; return False if a pivot is zero.

    Args:
        starts: (n + 1,) those of R_k are ``rows[starts[k]:starts[k + 1]]``, in ascending order.
        rows: (f,) all of them.
        lower: (f, 2) entries below the diagonal, overwritten with those of L.
        upper: (f, 2) entries above the diagonal, overwritten with those of U.
        diagonal: (n, 2) diagonal entries, overwritten with one over those of U.
    """
    n = diagonal.shape[0]
    below, right = np.zeros((n, 2)), np.zeros((n, 2))  # of column k and row k, by their places in the whole
    first, following, reached = np.full(n, -1), np.full(n, -1), np.zeros(n, np.uint32)  # lists of the j of every k
    for k in range(n):
        for at in range(starts[k], starts[k + 1]):
            i = rows[at]
            below[i, 0], below[i, 1], right[i, 0], right[i, 1] = lower[at, 0], lower[at, 1], upper[at, 0], upper[at, 1]
        pivot_0, pivot_1 = diagonal[k, 0], diagonal[k, 1]
        j = first[k]
        while j >= 0:
            at_k, end, other = reached[j], starts[j + 1], following[j]
            l_0, l_1, u_0, u_1 = lower[at_k, 0], lower[at_k, 1], upper[at_k, 0], upper[at_k, 1]
            pivot_0 -= l_0 * u_0
            pivot_1 -= l_1 * u_1
            after = at_k + np.uint32(1)
            for at in range(after, end):
                i = rows[at]
                # Read all, then write all: only then are they computed four at a time.
                a, b, c, d = lower[at, 0], lower[at, 1], upper[at, 0], upper[at, 1]
                p, q, r, s = below[i, 0], below[i, 1], right[i, 0], right[i, 1]
                p, q, r, s = p - a * u_0, q - b * u_1, r - c * l_0, s - d * l_1
                below[i, 0], below[i, 1], right[i, 0], right[i, 1] = p, q, r, s
            if after < end:  # j goes to the list of its next row
                reached[j] = after
                following[j], first[rows[after]] = first[rows[after]], j
            j = other
        if pivot_0 == 0.0 or pivot_1 == 0.0:
            return False
        diagonal[k, 0], diagonal[k, 1] = 1.0 / pivot_0, 1.0 / pivot_1
        for at in range(starts[k], starts[k + 1]):
            i = rows[at]
            lower[at, 0], lower[at, 1] = below[i, 0] * diagonal[k, 0], below[i, 1] * diagonal[k, 1]
            upper[at, 0], upper[at, 1] = right[i, 0], right[i, 1]
        if starts[k] < starts[k + 1]:
            reached[k] = starts[k]
            following[k], first[rows[starts[k]]] = first[rows[starts[k]]], k
    return True


@njit(cache=True, nogil=True)
def solve(
    starts: np.ndarray,
    rows: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    inverse: np.ndarray,
    places: np.ndarray,
    first: np.ndarray,
    second: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the solutions (n,) for right-hand sides (n,); ``places`` (n,) says where in the order an unknown is."""
    n = first.size
    x = np.empty((n, 2))
    for i in range(n):
        x[places[i], 0], x[places[i], 1] = first[i], second[i]
    for k in range(n):
        x_0, x_1 = x[k, 0], x[k, 1]
        for at in range(starts[k], starts[k + 1]):
            i = rows[at]
            p, q = x[i, 0] - lower[at, 0] * x_0, x[i, 1] - lower[at, 1] * x_1
            x[i, 0], x[i, 1] = p, q
    for k in range(n - 1, -1, -1):
        x_0, x_1 = x[k, 0], x[k, 1]
        for at in range(starts[k], starts[k + 1]):
            i = rows[at]
            x_0 -= upper[at, 0] * x[i, 0]
            x_1 -= upper[at, 1] * x[i, 1]
        x[k, 0], x[k, 1] = x_0 * inverse[k, 0], x_1 * inverse[k, 1]
    solution, other = np.empty(n), np.empty(n)
    for i in range(n):
        solution[i], other[i] = x[places[i], 0], x[places[i], 1]
    return solution, other
