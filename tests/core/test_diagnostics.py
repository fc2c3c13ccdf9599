"""Scores of a belief against exact values."""

import numpy as np
import pytest
from scipy.stats import kstest, norm

from dafw import ANGLE, POSITIVE, Ensemble, StateSpace, Variable
from dafw.core.diagnostics import error_of, innovation_scores, predicted_spread, ranks, scores
from dafw.core.observation import Observation, Selection

ANGLES = StateSpace([Variable("direction", 2, ANGLE), Variable("speed", 1)])


def test_the_error_of_an_angle_is_the_short_way_round():
    truth = np.array([2.0 * np.pi - 0.1, 0.2, 1.0])
    estimate = np.array([0.1, 2.0 * np.pi - 0.2, 9.0])
    expected = np.hypot(0.2, 0.4) / np.hypot(truth[0], truth[1]) * 100.0
    assert error_of(ANGLES, truth, estimate) == pytest.approx(expected)
    assert error_of(ANGLES, estimate, truth) == pytest.approx(
        np.hypot(0.2, 0.4) / np.hypot(estimate[0], estimate[1]) * 100
    )


def test_all_scores_of_an_angle_are_wrapped():
    truth = np.array([0.1, 0.1, 0.0])
    belief = Ensemble([[6.2, 6.2, 5.0], [6.2, 6.2, 5.0]], ANGLES)
    found = scores(ANGLES, truth, belief, belief, belief)
    missed = 0.1 - (6.2 - 2.0 * np.pi)
    assert found["rmse"] == pytest.approx(missed)
    for name in ("err", "err_forecast", "err_free"):
        assert found[name] == pytest.approx(missed / 0.1 * 100.0)
    assert found["spread"] == 0.0


@pytest.mark.parametrize("scale", [1000.0, 0.001])
def test_the_error_of_a_positive_number_is_a_share_of_the_truth_in_any_units(scale):
    rates = StateSpace([Variable("rate", 2, POSITIVE), Variable("level", 1)])
    truth = np.array([scale, 2.0 * scale, 5.0])
    twice = Ensemble([[2.0 * scale, 4.0 * scale, 0.0]] * 2, rates)
    found = scores(rates, truth, twice, twice, twice)
    assert [found[name] for name in ("err", "err_forecast", "err_free")] == pytest.approx([100.0] * 3)
    assert error_of(rates, truth, twice.mean) == pytest.approx(100.0)
    assert found["rmse"] == pytest.approx(np.log(2.0)) and found["spread"] == 0.0


LEVEL = StateSpace([Variable("level", 1)])


def reading(value, covariance):
    return Observation([value], Selection(indices=np.array([0]), covariance=np.array(covariance)))


@pytest.mark.parametrize("covariance", [[0.25], [[0.25]]])
def test_a_rank_is_the_average_of_what_the_members_expect(covariance):
    forecast = Ensemble([[1.0], [2.0], [4.0]], LEVEL)
    expected = norm.cdf((2.5 - np.array([1.0, 2.0, 4.0])) / 0.5)
    assert ranks(reading(2.5, covariance), forecast, forecast.members) == pytest.approx([expected.mean()])
    weighed = Ensemble(forecast.members, LEVEL, weights=[0.5, 0.25, 0.25])
    assert ranks(reading(2.5, covariance), weighed, weighed.members) == pytest.approx([expected @ weighed.weights])


def test_a_rank_is_right_to_two_parts_in_ten_million_wherever_the_reading_is():
    offsets = np.linspace(-10.0, 10.0, 100_003)
    observation = Observation(offsets, Selection(indices=np.arange(offsets.size), covariance=np.ones(offsets.size)))
    found = ranks(observation, Ensemble(np.zeros((1, 1)), LEVEL), np.zeros((1, offsets.size)))
    np.testing.assert_allclose(found, norm.cdf(offsets), rtol=0, atol=2e-7)


def test_ranks_of_many_readings_are_those_of_each():
    rng = np.random.default_rng(1000)
    members, values = rng.standard_normal((50, 90)), rng.standard_normal(90)
    space = StateSpace([Variable("level", 90)])
    observation = Observation(values, Selection(indices=np.arange(90), covariance=np.full(90, 0.25)))
    together = ranks(observation, Ensemble(members, space), members)
    one_by_one = [
        ranks(reading(value, [0.25]), Ensemble(column[:, np.newaxis], LEVEL), column[:, np.newaxis])[0]
        for value, column in zip(values, members.T, strict=True)
    ]
    np.testing.assert_allclose(together, one_by_one, rtol=1e-13)


def test_with_small_errors_a_rank_is_the_share_of_the_members_below():
    forecast = Ensemble([[1.0], [2.0], [4.0], [5.0]], LEVEL)
    assert ranks(reading(3.0, [1e-6]), forecast, forecast.members) == pytest.approx([0.5])
    assert ranks(reading(2.0, [1e-6]), forecast, forecast.members) == pytest.approx([0.375])


def test_ranks_of_an_honest_forecast_are_evenly_distributed():
    rng = np.random.default_rng(1000)
    found = []
    for _ in range(400):
        drawn = 3.0 + rng.standard_normal((41, 1))  # the first is the truth
        value = drawn[0, 0] + 0.5 * rng.standard_normal()
        found.append(ranks(reading(value, [0.25]), Ensemble(drawn[1:], LEVEL), drawn[1:])[0])
    assert kstest(found, "uniform").pvalue > 0.05
    assert kstest(np.array(found) ** 2, "uniform").pvalue < 1e-6, "the test can tell"


def test_an_innovation_is_compared_with_both_errors():
    forecast = Ensemble([[1.0], [2.0], [3.0]], LEVEL)
    spread = predicted_spread(forecast, forecast.members, forecast.mean)
    assert spread == pytest.approx([1.0])
    found = innovation_scores(reading(5.0, [3.0]), forecast.mean, spread)
    assert found == pytest.approx({"innovation_mean": 1.5, "innovation_rms": 1.5})
    weighed = Ensemble([[1.0], [2.0], [2.0], [3.0]], LEVEL, weights=[0.25, 0.25, 0.25, 0.25])
    same = Ensemble(weighed.members, LEVEL)
    assert predicted_spread(weighed, weighed.members, weighed.mean) == pytest.approx(
        predicted_spread(same, same.members, same.mean)
    )
