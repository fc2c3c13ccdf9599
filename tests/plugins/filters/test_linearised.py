"""A proposal of the linearised model is exact for a linear model, and steps are short where the model is not linear."""

from types import SimpleNamespace

import numpy as np
import pytest

from dafw import ANGLE, FIELD, StateSpace, Variable
from dafw.plugins.filters.controls import Controls
from dafw.plugins.filters.kernels import SMALLEST_SD
from dafw.plugins.filters.likelihood import Likelihood
from dafw.plugins.filters.linearised import REACH, can_linearise, linearised, lower_factor

SPACE = StateSpace([Variable("p", 1, FIELD), Variable("angle", 1, ANGLE)])
CONTROLS = Controls(SPACE)
SLOPES = np.array([[1.0, -2.0], [0.5, 1.0], [0.0, 3.0]])
TRUTH = np.array([1.3, 0.2])
LIKELIHOOD = Likelihood(absolute=[0.1])


def case(predict, centre=TRUTH, n=30):
    """Samples about ``centre``, and a window with exact readings at ``TRUTH``."""
    rng = np.random.default_rng(3)
    coordinates = centre + rng.normal(size=(n, 2)) * [0.5, 0.3]
    samples = SimpleNamespace(coordinates=coordinates, predicted=predict(coordinates), fit=np.zeros((n, 2, 1)))
    values = predict(TRUTH[np.newaxis])[0]
    cycles = [
        SimpleNamespace(number=number, observation=SimpleNamespace(values=values[[number]])) for number in range(3)
    ]
    window = SimpleNamespace(values=values, covariance=np.full(3, 0.03), cycles=cycles)
    return samples, window, np.full(n, 1.0 / n)


def proposal(samples, window, weights, likelihood=LIKELIHOOD):
    found = linearised(CONTROLS, samples, weights, weights, window, likelihood, 4, 0.5)
    return found.centres[0], found.factors[0] @ found.factors[0].T


def linear(z):
    return CONTROLS.offset(z, np.zeros(2)) @ SLOPES.T


def test_for_a_linear_model_every_step_ends_at_the_mean_of_the_posterior():
    samples, window, weights = case(linear, centre=TRUTH + np.array([0.4, -0.3]))
    ends, covariance = proposal(samples, window, weights)
    mean = samples.coordinates.mean(axis=0)
    prior = np.linalg.inv(REACH**2 * np.cov(samples.coordinates.T, bias=True))
    precision = SLOPES.T @ SLOPES / (0.03 + 0.1**2) + prior
    wanted = np.linalg.solve(precision, SLOPES.T @ window.values / (0.03 + 0.1**2) + prior @ mean)
    np.testing.assert_allclose(ends, np.broadcast_to(wanted, ends.shape), atol=1e-8)
    np.testing.assert_allclose(covariance, np.linalg.inv(precision), rtol=1e-6, atol=1e-10)


def test_angles_on_both_sides_of_a_whole_turn_belong_together():
    samples, window, weights = case(linear)
    ends, covariance = proposal(samples, window, weights)
    samples.coordinates[:, 1] = np.mod(samples.coordinates[:, 1], 2.0 * np.pi)
    turned, same = proposal(samples, window, weights)
    np.testing.assert_allclose(CONTROLS.offset(turned, ends), 0.0, atol=1e-9)
    np.testing.assert_allclose(same, covariance, rtol=1e-9)


def test_where_the_model_is_not_linear_the_proposal_is_wider():
    narrow = proposal(*case(linear))[1]
    wide = proposal(*case(lambda z: linear(z) + 2.0 * np.sin(20.0 * z[:, :1])))[1]
    assert np.linalg.det(wide) > 2.0 * np.linalg.det(narrow)


def test_a_heavy_tail_gives_an_outlier_little_pull():
    samples, window, weights = case(linear)
    window.values = window.values + np.array([0.0, 0.0, 50.0])
    misled = [
        np.abs(proposal(samples, window, weights, one)[0] - TRUTH).max()
        for one in (LIKELIHOOD, Likelihood(absolute=[0.1], degrees_of_freedom=4.0))
    ]
    assert misled[1] < 0.1 * misled[0]


@pytest.mark.parametrize(("n", "expected"), [(4, False), (5, True)])
def test_a_regression_needs_more_samples_than_slopes(n, expected):
    assert can_linearise(CONTROLS, np.full(n, 1.0 / n)) == expected


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_samples_that_are_all_but_equal_and_very_steep_models_are_no_trouble(scale):
    samples, window, weights = case(lambda z: 1e6 * linear(z))
    samples.coordinates[:, 0] = TRUTH[0] + scale * (samples.coordinates[:, 0] - TRUTH[0])
    samples.predicted = 1e6 * linear(samples.coordinates)
    ends, covariance = proposal(samples, window, weights)
    assert np.isfinite(ends).all() and (np.linalg.eigvalsh(covariance) > 0.0).all()


def test_the_factor_is_that_of_the_product():
    root = np.random.default_rng(2).normal(size=(3, 3))
    factor = lower_factor(root)
    np.testing.assert_allclose(factor @ factor.T, root.T @ root + SMALLEST_SD**2 * np.eye(3), rtol=1e-12, atol=1e-13)
    assert (factor == np.tril(factor)).all() and (np.diag(factor) > 0.0).all()
