"""Ranks of readings against the normal distribution, and those of several cycles together against those of each."""

import numpy as np
import pytest
from scipy.stats import kstest, norm

from dafw import Ensemble, StateSpace, Variable
from dafw.core.observation import Observation, Selection
from dafw.core.ranks import TOGETHER, Ranking, ranks

VARIANCE = np.array([0.25])


def test_a_rank_is_the_average_of_what_the_members_expect():
    predicted = np.array([[1.0], [2.0], [4.0]])
    expected = norm.cdf((2.5 - predicted[:, 0]) / 0.5)
    assert ranks(np.array([2.5]), VARIANCE, predicted) == pytest.approx([expected.mean()])
    weights = np.array([0.5, 0.25, 0.25])
    assert ranks(np.array([2.5]), VARIANCE, predicted, weights) == pytest.approx([expected @ weights])


def test_a_rank_is_right_to_two_parts_in_ten_million_wherever_the_reading_is():
    offsets = np.linspace(-10.0, 10.0, 100_003)
    found = ranks(offsets, np.ones(offsets.size), np.zeros((1, offsets.size)))
    np.testing.assert_allclose(found, norm.cdf(offsets), rtol=0, atol=2e-7)


def test_with_small_errors_a_rank_is_the_share_of_the_members_below():
    predicted, variance = np.array([[1.0], [2.0], [4.0], [5.0]]), np.array([1e-6])
    assert ranks(np.array([3.0]), variance, predicted) == pytest.approx([0.5])
    assert ranks(np.array([2.0]), variance, predicted) == pytest.approx([0.375])


def test_ranks_of_an_honest_forecast_are_evenly_distributed():
    rng = np.random.default_rng(1000)
    drawn = 3.0 + rng.standard_normal((41, 400))  # the first is the truth
    found = ranks(drawn[0] + 0.5 * rng.standard_normal(400), np.full(400, 0.25), drawn[1:])
    assert kstest(found, "uniform").pvalue > 0.05
    assert kstest(found**2, "uniform").pvalue < 1e-6, "the test can tell"


def cycle(rng, n_members, n_readings, *, weighted=False, full=False, order="C"):
    """Return the readings of a cycle, the forecast, and what it predicts for them."""
    members = np.asarray(rng.standard_normal((n_members, n_readings)), order=order)
    weights = rng.dirichlet(np.ones(n_members)) if weighted else None
    space = StateSpace([Variable("level", n_readings)])
    variance = rng.uniform(0.1, 0.5, n_readings)
    operator = Selection(indices=np.arange(n_readings), covariance=np.diag(variance) if full else variance)
    observation = Observation(rng.standard_normal(n_readings), operator)
    return observation, Ensemble(members, space, weights=weights), members


@pytest.mark.parametrize(
    "kinds",
    [
        [{"n_readings": 40}] * 30,
        [{"n_readings": 1 + number % 3} for number in range(30)],
        [{"n_readings": 40, "weighted": number % 2 == 1} for number in range(30)],
        [{"n_readings": 40, "full": True}] * 5,
        [{"n_readings": TOGETHER}] * 3,
        [{"n_readings": 40, "order": "F"}] * 30,
    ],
    ids=["the same number", "another number", "some with weights", "a full matrix", "many readings", "by columns"],
)
def test_ranks_of_cycles_together_are_those_of_each(kinds):
    rng = np.random.default_rng(7)
    ranking, told, expected = Ranking(), [], []
    for kind in kinds:
        observation, forecast, predicted = cycle(rng, 24, **kind)
        told.append(np.full(observation.values.size + 1, np.nan))  # and a reading of another cycle
        ranking.add(told[-1], observation, forecast, predicted)
        expected.append(ranks(observation.values, observation.variance, predicted, forecast.weights))
    ranking.settle()
    for one, right in zip(told, expected, strict=True):
        np.testing.assert_array_equal(one, [*right, np.nan])


def test_what_waits_is_a_copy():
    observation, forecast, predicted = cycle(np.random.default_rng(7), 8, 10)
    expected = ranks(observation.values, observation.variance, predicted)
    ranking, told = Ranking(), np.full(10, np.nan)
    ranking.add(told, observation, forecast, predicted)
    predicted[:] = 0.0  # an operator may use its array again
    ranking.settle()
    np.testing.assert_array_equal(told, expected)


def test_few_predictions_wait():
    observation, forecast, predicted = cycle(np.random.default_rng(7), 8, 100)
    ranking, told = Ranking(), []
    while not told or np.isnan(told[0]).all():
        told.append(np.full(100, np.nan))
        ranking.add(told[-1], observation, forecast, predicted)
    assert len(told) == -(-TOGETHER // predicted.size)
    ranking.settle()  # nothing waits any more
    assert np.isfinite(told).all()
