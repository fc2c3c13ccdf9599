"""Scores of a belief against exact values."""

import numpy as np
import pytest

from dafw import ANGLE, Ensemble, StateSpace, Variable
from dafw.core.diagnostics import error_of, scores

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
