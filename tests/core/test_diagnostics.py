"""Scores of a belief against exact values."""

import numpy as np
import pytest

from dafw import ANGLE, POSITIVE, Ensemble, StateSpace, Variable
from dafw.core.diagnostics import error_of, innovation_scores, predicted_spread, scores
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
