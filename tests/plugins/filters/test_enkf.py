"""The EnKF with perturbed observations: its formula in the readings' space, exact mean, exact expected covariance."""

# ruff: noqa: N803, N806  (the letters of the formulas)

import numpy as np
import pytest

from dafw.core.ensemble import Ensemble
from dafw.core.observation import Observation, Selection
from dafw.core.space import ANGLE, NONNEGATIVE, StateSpace, Variable
from dafw.plugins.filters.enkf import EnKF


def problem(n_members=10, n=5, m=3, full=True):
    rng = np.random.default_rng(n_members)
    root = rng.normal(size=(m, m))
    R = root @ root.T + 0.5 * np.eye(m) if full else np.diag(rng.uniform(0.1, 2.0, m))
    forecast = Ensemble(rng.normal(size=(n_members, n)) * 2.0 + 1.0, StateSpace([Variable("u", n)]))
    operator = Selection(indices=np.arange(m), covariance=R if full else np.diag(R))
    return forecast, Observation(rng.normal(size=m), operator), R


def gain(forecast, m, R):
    P = np.cov(forecast.members, rowvar=False)
    return P[:, :m] @ np.linalg.inv(P[:m, :m] + R)


def analysed(forecast, observation, seed=0, **options):
    predicted = observation.operator.apply(forecast.members)
    return EnKF(**options).update(forecast, predicted, observation, None, np.random.default_rng(seed)).members


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize(("n_members", "m"), [(2, 3), (10, 1), (10, 3), (4, 5)])
def test_each_member_is_moved_by_the_gain_towards_its_own_readings(n_members, m, full):
    forecast, observation, R = problem(n_members, 5, m, full)
    Z = np.random.default_rng(3).standard_normal((n_members, m))
    errors = (Z - Z.mean(axis=0)) @ np.linalg.cholesky(R).T
    innovations = observation.values - errors - forecast.members[:, :m]
    expected = forecast.members + innovations @ gain(forecast, m, R).T
    np.testing.assert_allclose(analysed(forecast, observation, seed=3), expected, rtol=0, atol=1e-10)


def test_mean_is_the_kalman_filters_whatever_is_drawn():
    forecast, observation, R = problem()
    expected = forecast.mean + gain(forecast, 3, R) @ (observation.values - forecast.mean[:3])
    for seed in range(5):
        np.testing.assert_allclose(analysed(forecast, observation, seed).mean(axis=0), expected, rtol=0, atol=1e-10)


def test_covariance_is_the_kalman_filters_on_average():
    forecast, observation, R = problem()
    P = np.cov(forecast.members, rowvar=False)
    expected = P - gain(forecast, 3, R) @ P[:3]
    drawn = np.array([np.cov(analysed(forecast, observation, seed), rowvar=False) for seed in range(2000)])
    error = np.abs(drawn.mean(axis=0) - expected) / (drawn.std(axis=0) / np.sqrt(len(drawn)) + 1e-12)
    assert error.max() < 5.0


def test_inflation_is_that_of_the_forecast_anomalies():
    forecast, observation, _ = problem()
    inflated = Ensemble(forecast.mean + 1.3 * forecast.anomalies, forecast.space)
    found, expected = analysed(forecast, observation, inflation=1.3), analysed(inflated, observation)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


def test_angles_and_nonnegative_values_stay_in_their_sets():
    rng = np.random.default_rng(0)
    space = StateSpace([Variable("c", 3, NONNEGATIVE), Variable("angle", 1, ANGLE)])
    members = np.column_stack([rng.uniform(0, 0.2, (20, 3)), rng.normal(0, 0.5, 20) % (2 * np.pi)])
    operator = Selection(indices=np.array([0]), covariance=np.array([1e-4]))
    analysis = analysed(Ensemble(members, space), Observation(np.array([-0.3]), operator))
    assert analysis[:, :3].min() == 0.0
    assert np.all((analysis[:, 3] >= 0.0) & (analysis[:, 3] < 2 * np.pi))
    # Directions around 0 = 2 pi stay together; they are not averaged to pi.
    assert np.cos(analysis[:, 3]).mean() > 0.7
