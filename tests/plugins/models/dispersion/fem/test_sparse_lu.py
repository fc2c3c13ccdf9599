"""The sparse LU without pivoting, of one matrix and of two: against dense algebra, used again, and what is refused."""

import dolfinx_solver  # noqa: F401  (before dolfinx)

# isort: split
import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.spatial import Delaunay

from dafw.core.errors import SolverError
from dafw.plugins.models.dispersion.fem.paired_lu import PairedLU
from dafw.plugins.models.dispersion.fem.sparse_lu import Elimination, SparseLU

N = 120


class FirstOfTwo(PairedLU):
    """The factorisation of a pair, used for its first matrix."""

    def factorise(self, values):
        super().factorise(values, self.other)

    def solve(self, right):
        columns = right.reshape(N, -1).T
        return np.array([super(FirstOfTwo, self).solve(one, one)[0] for one in columns]).T.reshape(right.shape)


class SecondOfTwo(PairedLU):
    """The same for its second matrix."""

    def factorise(self, values):
        super().factorise(self.other, values)

    def solve(self, right):
        columns = right.reshape(N, -1).T
        return np.array([super(SecondOfTwo, self).solve(one, one)[1] for one in columns]).T.reshape(right.shape)


@pytest.fixture(params=[SparseLU, FirstOfTwo, SecondOfTwo])
def kind(request, pattern, monkeypatch):
    """What makes a factorisation of one matrix, beside another one or alone."""
    monkeypatch.setattr(PairedLU, "other", dominant(pattern, 9), raising=False)
    return request.param


@pytest.fixture(scope="module")
def pattern():
    """The sparsity pattern (indptr, indices) of a mesh of random points."""
    first, indices = Delaunay(np.random.default_rng(5).random((N, 2))).vertex_neighbor_vertices
    edges = np.repeat(np.arange(N), np.diff(first)), indices
    whole = csr_matrix((np.ones(indices.size), edges), shape=(N, N)) + csr_matrix(np.eye(N))
    whole.sort_indices()
    return whole.indptr, whole.indices


@pytest.fixture(scope="module")
def elimination(pattern):
    return Elimination(*pattern)


def matrix(pattern, values):
    return csr_matrix((values, pattern[1], pattern[0]), shape=(N, N))


def dominant(pattern, seed, sign=1.0):
    """Return CSR values of a matrix that is not symmetric and needs no pivoting."""
    indptr, indices = pattern
    values = np.random.default_rng(seed).uniform(-1.0, 1.0, indices.size)
    values[indices == np.repeat(np.arange(N), np.diff(indptr))] = sign * 20.0
    return values


@pytest.mark.parametrize("scale", [1e-60, 1.0, 1e60])
def test_solutions_are_those_of_dense_algebra(pattern, elimination, kind, scale):
    values = scale * dominant(pattern, 1)
    right = np.random.default_rng(2).standard_normal((N, 3))
    factors = kind(elimination)
    factors.factorise(values)
    expected = np.linalg.solve(matrix(pattern, values).toarray(), right)
    np.testing.assert_allclose(factors.solve(right), expected, rtol=1e-12, atol=1e-14 / scale)
    assert np.array_equal(factors.solve(right[:, 1]), factors.solve(right)[:, 1])
    if kind is SparseLU:
        ordered = factors.solve_ordered(right[elimination.order, 0])
        assert np.array_equal(ordered[elimination.places], factors.solve(right[:, 0]))


def test_the_order_leaves_fewer_entries_than_the_nodes_numbers(pattern, elimination):
    """Of the Cholesky factor of a matrix with this pattern, counted in dense algebra."""

    def filled(order):
        laplacian = -1.0 * (matrix(pattern, np.ones(pattern[1].size)).toarray() != 0.0)
        np.fill_diagonal(laplacian, N)
        return np.count_nonzero(np.abs(np.linalg.cholesky(laplacian[np.ix_(order, order)])) > 1e-300)

    assert sorted(elimination.order) == list(range(N))
    assert filled(elimination.order) < 0.5 * filled(np.arange(N))


def test_an_object_that_is_used_again_has_the_bits_of_a_new_one(pattern, elimination, kind):
    right = np.random.default_rng(3).standard_normal(N)
    used, new = kind(elimination), kind(elimination)
    used.factorise(dominant(pattern, 1))
    used.solve(right)
    with pytest.raises(SolverError):
        used.factorise(np.zeros(pattern[1].size))
    for factors in (used, new):
        factors.factorise(dominant(pattern, 2, sign=-1.0))
    assert np.array_equal(used.solve(right), new.solve(right))


def test_matrices_that_cannot_be_solved_with_are_refused(pattern, elimination, kind):
    indptr, indices = pattern
    rows = np.repeat(np.arange(N), np.diff(indptr))
    diagonal = rows == indices
    graph = np.where(diagonal, np.repeat(np.diff(indptr) - 1.0, np.diff(indptr)), -1.0)  # constants are mapped to zero
    first = elimination.order[0]
    tiny = dominant(pattern, 1)
    tiny[diagonal & (rows == first)] = 1e-14  # the first pivot: pivoting would do
    spoilt = dominant(pattern, 1)
    spoilt[7] = np.nan
    factors = kind(elimination)
    for values, words in (
        (np.zeros(indices.size), "a pivot is zero"),
        (graph, "singular"),
        (tiny, "without pivoting a residual of"),
        (spoilt, "singular to working precision.* is nan"),
    ):
        with pytest.raises(SolverError, match=f"sparse LU: .*{words}"):
            factors.factorise(values)
        with pytest.raises(SolverError, match="there is no factorisation, or the last one failed"):
            factors.solve(np.ones(N))
    assert np.isfinite(np.linalg.solve(matrix(pattern, tiny).toarray(), np.ones(N))).all()


def test_right_hand_sides_that_are_not_finite_are_refused(pattern, elimination, kind):
    factors = kind(elimination)
    factors.factorise(dominant(pattern, 1))
    with pytest.raises(SolverError, match="a solution is not finite"):
        factors.solve(np.full(N, np.nan))


def test_two_matrices_are_solved_with_their_own_right_hand_sides(pattern, elimination):
    values = dominant(pattern, 1), dominant(pattern, 2, sign=-1.0)
    rights = np.random.default_rng(3).standard_normal((2, N))
    factors = PairedLU(elimination)
    factors.factorise(*values)
    for one, right, solution in zip(values, rights, factors.solve(*rights), strict=True):
        np.testing.assert_allclose(matrix(pattern, one) @ solution, right, atol=1e-13)


def test_the_fill_has_room_for_all_entries_of_the_factors(pattern, elimination):
    """Compared with a Cholesky factor in dense algebra, whose entries do not cancel."""
    laplacian = -1.0 * (matrix(pattern, np.ones(pattern[1].size)).toarray() != 0.0)
    np.fill_diagonal(laplacian, N)
    order, fill = elimination.order, elimination.fill
    factor = np.tril(np.linalg.cholesky(laplacian[np.ix_(order, order)]), -1)
    rows, columns = np.nonzero(np.abs(factor) > 1e-300)
    sorted_by_columns = np.lexsort((rows, columns))
    np.testing.assert_array_equal(fill.rows, rows[sorted_by_columns])
    np.testing.assert_array_equal(np.diff(fill.starts.astype(int)), np.bincount(columns, minlength=N))
