"""The mean of a linear field along a line, against exact answers and a fine sum."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.tri import LinearTriInterpolator, Triangulation

from dafw import ConfigurationError
from dafw.core.line_means import line_mean

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
TWO = np.array([[0, 1, 3], [0, 3, 2]], dtype=np.int32)


def scattered(seed, count=60):
    """Return a mesh of the unit square with nodes anywhere."""
    rng = np.random.default_rng(seed)
    nodes = np.vstack([SQUARE, rng.random((count, 2))])
    return nodes, Triangulation(*nodes.T).triangles


def mean(nodes, triangles, field, start, end):
    found, weights = line_mean(nodes, triangles, np.array(start), np.array(end))
    assert len(set(found.tolist())) == len(found)
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)
    return float(weights @ field[found])


@pytest.mark.parametrize("seed", range(5))
def test_a_field_that_is_linear_everywhere_has_the_mean_of_the_middle(seed):
    nodes, triangles = scattered(seed)
    start, end = np.random.default_rng(100 + seed).random((2, 2))
    field = 3.0 + nodes @ [2.0, -5.0]
    assert mean(nodes, triangles, field, start, end) == pytest.approx(3.0 + 0.5 * (start + end) @ [2.0, -5.0], abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_any_field_has_the_mean_of_a_fine_sum(seed):
    nodes, triangles = scattered(seed)
    rng = np.random.default_rng(200 + seed)
    field, (start, end) = rng.random(len(nodes)), 0.02 + 0.96 * rng.random((2, 2))
    s = (np.arange(200_000) + 0.5) / 200_000
    points = start + s[:, np.newaxis] * (end - start)
    fine = LinearTriInterpolator(Triangulation(*nodes.T, triangles), field)(*points.T)
    assert mean(nodes, triangles, field, start, end) == pytest.approx(float(fine.mean()), abs=1e-7)


def test_a_hat_has_its_own_integral():
    # The hat of node 0 falls from 1 to 0 along either edge: the mean of an edge is 1/2, that of the diagonal, too.
    hat = np.array([1.0, 0.0, 0.0, 0.0])
    assert mean(SQUARE, TWO, hat, [0, 0], [1, 0]) == pytest.approx(0.5)
    assert mean(SQUARE, TWO, hat, [0, 0], [1, 1]) == pytest.approx(0.5)
    assert mean(SQUARE, TWO, hat, [1, 1], [0, 0]) == pytest.approx(0.5)
    assert mean(SQUARE, TWO, hat, [1, 0], [0, 1]) == pytest.approx(0.25)  # 1/2 where it crosses the diagonal


def test_an_edge_between_two_triangles_counts_once():
    field = np.array([0.0, 7.0, -3.0, 4.0])
    assert mean(SQUARE, TWO, field, [0.25, 0.25], [0.75, 0.75]) == pytest.approx(2.0)


def test_clockwise_triangles_are_as_good():
    field = np.array([0.0, 7.0, -3.0, 4.0])
    args = (field, [0.1, 0.3], [0.9, 0.6])
    assert mean(SQUARE, TWO[:, ::-1], *args) == pytest.approx(mean(SQUARE, TWO, *args), abs=1e-12)


@pytest.mark.parametrize(
    ("start", "end", "said"),
    [
        ([0.5, 0.5], [1.5, 0.5], "leaves the mesh: 0.5 of it"),
        ([2.0, 2.0], [3.0, 2.0], "leaves the mesh: 1 of it"),
        ([0.5, 0.5], [0.5, 0.5], "has no length"),
    ],
)
def test_a_line_off_the_mesh_is_refused(start, end, said):
    with pytest.raises(ConfigurationError, match=said):
        line_mean(SQUARE, TWO, np.array(start), np.array(end))


def test_a_line_through_a_hole_is_refused():
    with pytest.raises(ConfigurationError, match="leaves the mesh"):
        line_mean(SQUARE, TWO[:1], np.array([0.9, 0.1]), np.array([0.1, 0.9]))
