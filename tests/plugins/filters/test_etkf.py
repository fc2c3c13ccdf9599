"""The ETKF against the paper's formulas, evaluated independently, and against the exact Kalman moments."""

# ruff: noqa: E741, N803, N806  (the letters of the formulas)

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from dafw.core.ensemble import Ensemble
from dafw.core.observation import Observation, Selection
from dafw.core.space import ANGLE, NONNEGATIVE, StateSpace, Variable
from dafw.plugins.filters.etkf import ETKF, rotated_transform, transform


def algorithm_1(C, w_speed, w_direction, H, O, sigma_ob):
    """The analysis of Gioia et al. (2024), Algorithm 1, line by line; H (M, m) selects, R^-1 = Diag(1 / sigma_ob)."""
    N = len(C)
    A = C - C.mean(axis=0)
    A_speed = w_speed - w_speed.mean()
    mu_circ = np.arctan2(np.sin(w_direction).mean(), np.cos(w_direction).mean()) % (2 * np.pi)
    A_direction = (w_direction - mu_circ + np.pi) % (2 * np.pi) - np.pi
    Y = C @ H - (C @ H).mean(axis=0)
    dy = O - (C @ H).mean(axis=0)
    R_inverse = np.diag(np.full(H.shape[1], 1 / sigma_ob))
    d, V = np.linalg.eigh(Y @ R_inverse @ Y.T + (N - 1) * np.eye(N))
    T = np.sqrt(N - 1) * V @ np.diag(1 / np.sqrt(d)) @ V.T
    P = V @ np.diag(1 / d) @ V.T
    Lambda = (dy @ R_inverse) @ (Y.T @ P)
    anomalies = np.column_stack([A, A_speed, A_direction])
    mean = np.concatenate([C.mean(axis=0), [w_speed.mean(), mu_circ]])
    E = mean + Lambda @ anomalies + T @ anomalies
    M = C.shape[1]
    return np.maximum(0, E[:, :M]), np.maximum(0, E[:, M]), E[:, M + 1] % (2 * np.pi)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("N", "observed"), [(10, [3]), (10, [3, 17]), (3, [0, 1, 2, 5, 8])])
def test_agrees_with_the_papers_algorithm(seed, N, observed):
    rng = np.random.default_rng(seed)
    M, sigma_ob = 30, 1e-3
    C = np.maximum(rng.normal(0.02, 0.05, (N, M)), 0)
    w_speed = rng.weibull(0.85, N) * 2.3
    w_direction = rng.normal(0, 0.8, N) % (2 * np.pi)  # around 0 = 2 pi
    O = rng.normal(0.05, 0.03, len(observed))
    expected = algorithm_1(C, w_speed, w_direction, np.eye(M)[:, observed], O, sigma_ob)
    assert (expected[0] == 0).any()  # so the clamp had an effect

    space = StateSpace(
        [
            Variable("concentration", M, NONNEGATIVE),
            Variable("wind_speed", 1, NONNEGATIVE),
            Variable("wind_direction", 1, ANGLE),
        ]
    )
    # Algorithm 1 divides by sigma_ob, which corresponds to a covariance of sigma_ob.
    operator = Selection(indices=np.array(observed), covariance=np.full(len(observed), sigma_ob))
    forecast = Ensemble(np.column_stack([C, w_speed, w_direction]), space)
    found = ETKF().update(forecast, operator.apply(forecast.members), Observation(O, operator), None, rng).members
    np.testing.assert_allclose(found[:, :M], expected[0], rtol=0, atol=1e-10)
    np.testing.assert_allclose(found[:, M], expected[1], rtol=0, atol=1e-10)
    np.testing.assert_allclose(np.exp(1j * found[:, M + 1]), np.exp(1j * expected[2]), rtol=0, atol=1e-10)
    assert np.all((found[:, M + 1] >= 0) & (found[:, M + 1] < 2 * np.pi))


def linear_problem(seed, n_members, n=6, full=False):
    """A forecast of fields, two readings of it, and the exact moments of the ensemble's own analysis."""
    rng = np.random.default_rng(seed)
    space = StateSpace([Variable("u", n)])
    forecast = Ensemble(rng.normal(1.0, 2.0, (n_members, n)) @ rng.normal(size=(n, n)), space)
    root = rng.normal(size=(3, 3))
    R = root @ root.T + np.eye(3) if full else np.diag([0.5, 2.0, 1e-2])
    operator = Selection(indices=np.array([4, 0, 1]), covariance=R if full else np.diag(R))
    observation = Observation(rng.normal(size=3), operator)
    engine = KalmanFilter(dim_x=n, dim_z=3)
    engine.x, engine.P = forecast.members.mean(axis=0)[:, None], np.cov(forecast.members, rowvar=False)
    engine.update(observation.values[:, None], R=R, H=np.eye(n)[[4, 0, 1]])
    return forecast, observation, engine.x[:, 0], engine.P


@pytest.mark.parametrize("rotation", [False, True])
@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("n_members", [2, 4, 6, 20])
def test_mean_and_covariance_are_the_kalman_filters(n_members, full, rotation):
    forecast, observation, mean, covariance = linear_problem(n_members, n_members, full=full)
    predicted = observation.operator.apply(forecast.members)
    analysis = ETKF(rotation=rotation).update(forecast, predicted, observation, None, np.random.default_rng(5)).members
    scale = np.abs(forecast.members).max()
    np.testing.assert_allclose(analysis.mean(axis=0), mean, rtol=0, atol=1e-10 * scale)
    np.testing.assert_allclose(np.cov(analysis, rowvar=False), covariance, rtol=0, atol=1e-10 * scale**2)


def test_inflation_is_that_of_the_forecast_anomalies():
    forecast, observation, _, _ = linear_problem(0, 8)
    inflated = Ensemble(forecast.mean + 1.3 * forecast.anomalies, forecast.space)
    apply, rng = observation.operator.apply, np.random.default_rng(0)
    found = ETKF(inflation=1.3).update(forecast, apply(forecast.members), observation, None, rng).members
    expected = ETKF().update(inflated, apply(inflated.members), observation, None, rng).members
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


def test_only_rotation_draws_random_numbers():
    forecast, observation, _, _ = linear_problem(0, 8)
    predicted = observation.operator.apply(forecast.members)

    def members(seed, rotation):
        rng = np.random.default_rng(seed)
        return ETKF(rotation=rotation).update(forecast, predicted, observation, None, rng).members

    assert np.array_equal(members(1, False), members(2, False))
    assert np.array_equal(members(1, True), members(1, True))
    assert np.abs(members(1, True) - members(2, True)).max() > 0.1


@pytest.mark.parametrize("n_members", [2, 3, 24])
def test_rotation_is_that_of_the_symmetric_root_and_keeps_the_mean(n_members):
    rng = np.random.default_rng(n_members)
    Y = rng.normal(size=(n_members, 4))
    problem = (Y - Y.mean(axis=0), rng.normal(size=4), rng.uniform(0.5, 2.0, 4))
    Lambda, T = transform(*problem)
    rotated_Lambda, UT = rotated_transform(*problem, rng)
    U = UT @ np.linalg.inv(T)
    np.testing.assert_allclose(rotated_Lambda, Lambda, rtol=0, atol=1e-13)
    np.testing.assert_allclose(U @ U.T, np.eye(n_members), rtol=0, atol=1e-12)
    np.testing.assert_allclose(U @ np.ones(n_members), 1.0, rtol=0, atol=1e-12)


def test_rotations_are_uniform():
    # The average over all rotations of zero-mean vectors is zero; each entry has a variance of about 1 / N.
    rng, draws = np.random.default_rng(0), 4000
    nothing = (np.zeros((5, 1)), np.zeros(1), np.ones(1))
    average = sum(rotated_transform(*nothing, rng)[1] for _ in range(draws)) / draws
    np.testing.assert_allclose(average, 1 / 5, rtol=0, atol=5 / np.sqrt(5 * draws))
