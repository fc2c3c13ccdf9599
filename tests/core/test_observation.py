"""Observation operators: selection, stacking, covariances."""

import numpy as np
import pytest

from dafw import ConfigurationError, ObservationOperator, Selection
from dafw.core.covariances import colour, whiten, whiten_both
from dafw.core.observation import Interpolation, Stacked, stack

MEMBERS = np.arange(12.0).reshape(3, 4)
FULL = np.array([[2.0, 0.5], [0.5, 1.0]])


class Sum(ObservationOperator):
    """Reads the sum of the state."""

    def apply(self, members):
        return members.sum(axis=1, keepdims=True)


def test_a_selection_reads_entries():
    operator = Selection(indices=np.array([3, 1]), covariance=np.ones(2))
    np.testing.assert_array_equal(operator.apply(MEMBERS), MEMBERS[:, [3, 1]])


def test_the_noise_is_the_covariance_unless_set_apart():
    told = Selection(indices=np.array([0]), covariance=np.array([1e-3]))
    apart = Selection(indices=np.array([0]), covariance=np.array([1e-3]), noise_covariance=np.array([1e-6]))
    assert told.noise == 1e-3 and apart.noise == 1e-6 and apart.covariance == 1e-3


def test_stacked_selections_stay_a_selection():
    stacked = stack(
        (
            Selection(indices=np.array([0]), covariance=np.array([1.0]), coordinates=np.array([[1.0, 2.0]])),
            Selection(indices=np.array([2, 3]), covariance=np.array([2.0, 3.0])),
        )
    )
    assert isinstance(stacked, Selection)
    np.testing.assert_array_equal(stacked.apply(MEMBERS), MEMBERS[:, [0, 2, 3]])
    np.testing.assert_array_equal(stacked.covariance, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(stacked.coordinates, [[1, 2], [np.nan, np.nan], [np.nan, np.nan]])


def test_stacked_interpolations_stay_one_with_the_same_readings():
    def between(first, second, share, **more):
        places = {"indices": np.array([[first, second]]), "weights": np.array([[1.0 - share, share]])}
        return Interpolation(covariance=np.array([0.5 + share]), sensors=("a",), **places, **more)

    parts = (between(0, 1, 0.25), between(2, 3, 0.5, limits=np.array([0.1])), between(1, 3, 1.0, spans=np.array([4.0])))
    stacked = stack(parts, same_sensors=True)
    assert isinstance(stacked, Interpolation) and stacked.sensors == ("a",) * 3 and stacked.noise_covariance is None
    np.testing.assert_allclose(
        stacked.apply(MEMBERS), np.hstack([part.apply(MEMBERS) for part in parts]), rtol=1e-15, atol=0
    )
    np.testing.assert_array_equal(stacked.covariance, [0.75, 1.0, 1.5])
    np.testing.assert_array_equal(stacked.limits, [np.nan, 0.1, np.nan])
    np.testing.assert_array_equal(stacked.spans, [0.0, 0.0, 4.0])
    # Of other widths, or beside other operators, they stay apart.
    wider = Interpolation(indices=np.array([[0, 1, 2]]), weights=np.ones((1, 3)) / 3.0, covariance=np.ones(1))
    for other in (wider, Sum(covariance=np.ones(1))):
        mixed = stack((parts[0], other))
        assert isinstance(mixed, Stacked)
        np.testing.assert_array_equal(mixed.apply(MEMBERS)[:, 1:], other.apply(MEMBERS))


def test_places_of_any_dimension_are_stacked():
    line = Selection(indices=np.array([0]), covariance=np.ones(1), coordinates=np.array([[7.0]]))
    nowhere = Selection(indices=np.array([1]), covariance=np.ones(1))
    none_due = Selection(indices=np.array([], dtype=int), covariance=np.ones(0), coordinates=np.empty((0, 2)))
    np.testing.assert_array_equal(stack((nowhere, line, none_due)).coordinates, [[np.nan], [7.0]])
    assert stack((nowhere, none_due)).coordinates is None


def test_stacking_keeps_full_covariances_block_diagonal():
    stacked = stack((Selection(indices=np.array([0, 1]), covariance=FULL), Sum(covariance=np.array([4.0]))))
    assert isinstance(stacked, Stacked)
    np.testing.assert_array_equal(stacked.covariance, [[2.0, 0.5, 0], [0.5, 1.0, 0], [0, 0, 4.0]])
    np.testing.assert_array_equal(stacked.apply(MEMBERS)[:, 2], MEMBERS.sum(axis=1))


@pytest.mark.parametrize("covariance", [FULL, np.array([2.0, 3.0])], ids=["full", "diagonal"])
def test_whitening_undoes_colouring(covariance):
    rows = np.random.default_rng(0).standard_normal((5, 2))
    np.testing.assert_allclose(whiten(covariance, colour(covariance, rows)), rows, atol=1e-14)
    np.testing.assert_allclose(whiten(covariance, colour(covariance, rows[0])), rows[0], atol=1e-14)
    matrix = covariance if covariance.ndim == 2 else np.diag(covariance)
    inner = whiten(covariance, rows) @ whiten(covariance, rows).T
    np.testing.assert_allclose(inner, rows @ np.linalg.inv(matrix) @ rows.T, atol=1e-13)


@pytest.mark.parametrize("covariance", [FULL, np.array([2.0, 3.0])], ids=["full", "diagonal"])
@pytest.mark.parametrize("shape", [(2,), (1, 2), (4, 2)])
def test_whitening_both_is_whitening_each(covariance, shape):
    generator = np.random.default_rng(1)
    first, second = generator.standard_normal((5, 2)), generator.standard_normal(shape)
    for both, one in zip(whiten_both(covariance, first, second), (first, second), strict=True):
        assert both.shape == one.shape
        np.testing.assert_allclose(both, whiten(covariance, one), rtol=1e-14)


@pytest.mark.parametrize(
    ("covariance", "message"),
    [(np.ones((2, 3)), r"shape \(2, 3\)"), (np.array([1.0, 0.0]), "not above zero"), (np.ones((2, 2, 2)), "shape")],
)
def test_covariances_that_are_none_are_refused(covariance, message):
    with pytest.raises(ConfigurationError, match=message):
        Selection(indices=np.array([0, 1]), covariance=covariance)
