"""The ensemble Kalman smoother compared with the Rauch-Tung-Striebel smoother, and the effect of late readings.

The ensemble is made so that its sample moments are exact: first guess and model errors of all cycles are columns of
one orthogonal matrix, each used once. So a linear problem has no sampling error at all.
"""

from dataclasses import dataclass, field

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter, rts_smoother

import dafw
from dafw import Model, Selection, StateSpace, Study, Variable
from dafw.core.cycle import advance, start
from dafw.plugins.filters.enks import EnKS
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.filters.rotation import zero_mean_basis
from dafw.plugins.readings.listed import Listed

N, CYCLES = 24, 8
F = np.array([[1.0, 0.5], [-0.3, 0.9]])
P0 = np.array([[2.0, 0.3], [0.3, 1.0]])
Q = np.array([[0.2, 0.05], [0.05, 0.1]])
MEAN = np.array([1.0, -2.0])
SD = 0.7
SPACE = StateSpace([Variable("level", 2)])
SILENT = {2, 5}
VALUES = np.random.default_rng(3).normal(0.0, 2.0, CYCLES)


def exact_draws(number: int, covariance: np.ndarray) -> np.ndarray:
    """Return anomalies (N, 2) with exactly this covariance, uncorrelated with those for every other ``number``."""
    columns = zero_mean_basis(N)[:, 2 * number : 2 * number + 2]
    return np.sqrt(N - 1) * columns @ np.linalg.cholesky(covariance).T


@dataclass
class Exact(Model):
    """x <- F x + e, with draws whose sample moments are exact."""

    dt: float = 1.0
    space: StateSpace = field(default_factory=lambda: SPACE)

    def initial(self, n_members, rng):
        return MEAN + exact_draws(0, P0)

    def step(self, members, t, rng):
        return members @ F.T + exact_draws(1 + round(t), Q)


def readings(late=()):
    """Return the readings of all cycles but the silent ones; those of the cycles ``late`` arrive in the last."""
    return Listed(
        readings=[
            {"time": cycle + 1.0, "value": float(VALUES[cycle]), "entry": 0, "sd": SD}
            | ({"arrives": float(CYCLES)} if cycle in late else {})
            for cycle in range(CYCLES)
            if cycle not in SILENT
        ]
    )


def study(filter_, late=(), **options):
    return Study(model=Exact(), filter=filter_, readings=readings(late), members=N, cycles=CYCLES, **options)


def rauch_tung_striebel(until=CYCLES):
    """Return means (T + 1, 2) and covariances of the states at all times, given the readings until a cycle."""
    engine = KalmanFilter(dim_x=2, dim_z=1)
    engine.x, engine.P, engine.F, engine.Q = MEAN[:, np.newaxis].copy(), P0.copy(), F, Q
    engine.H, engine.R = np.array([[1.0, 0.0]]), np.array([[SD**2]])
    means, covariances = [engine.x.copy()], [engine.P.copy()]
    for cycle in range(until):
        engine.predict()
        if cycle not in SILENT:
            engine.update(np.array([[VALUES[cycle]]]))
        means.append(engine.x.copy())
        covariances.append(engine.P.copy())
    size = len(means)
    smoothed = rts_smoother(np.array(means), np.array(covariances), np.array([F] * size), np.array([Q] * size))
    return smoothed[0][:, :, 0], smoothed[1]


def beliefs(filter_, late=()):
    """Return the beliefs at all times as last revised, by the number of cycles done."""
    parts, vehicle = study(filter_, late).prepare()
    state = start(parts, N, vehicle)
    found = {0: state.belief.ensemble}
    for done in range(1, CYCLES + 1):
        cycle = advance(parts, state)
        state = cycle.state
        found |= {number: belief.ensemble for number, belief in cycle.analysis.revised.items()}
        found[done] = state.belief.ensemble
    return found


def covariance(ensemble):
    return ensemble.anomalies.T @ ensemble.anomalies / (N - 1)


def test_the_fixed_interval_smoother_is_rauch_tung_striebel_silent_cycles_included():
    means, covariances = rauch_tung_striebel()
    for done, belief in beliefs(EnKS()).items():
        np.testing.assert_allclose(belief.mean, means[done], rtol=0, atol=1e-9)
        np.testing.assert_allclose(covariance(belief), covariances[done], rtol=0, atol=1e-9)


@pytest.mark.parametrize("lag", [1, 3])
def test_the_fixed_lag_smoother_knows_the_readings_of_so_many_cycles_and_no_others(lag):
    found = beliefs(EnKS(window=lag))
    for done in range(CYCLES + 1):
        # The belief at the beginning of a cycle is revised until that cycle leaves the window.
        last = min(CYCLES, done + lag)
        while last - 1 in SILENT and last > done:
            last -= 1  # the window's last cycle had no readings
        means, covariances = rauch_tung_striebel(last)
        np.testing.assert_allclose(found[done].mean, means[done], rtol=0, atol=1e-9)
        np.testing.assert_allclose(covariance(found[done]), covariances[done], rtol=0, atol=1e-9)


def test_the_present_is_the_etkfs():
    smoother, filter_ = beliefs(EnKS())[CYCLES], [cycle.state.belief.ensemble for cycle in study(ETKF())][-1]
    np.testing.assert_allclose(smoother.mean, filter_.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(covariance(smoother), covariance(filter_), rtol=0, atol=1e-9)


def test_readings_that_come_late_end_in_the_same_beliefs():
    means, covariances = rauch_tung_striebel()
    for done, belief in beliefs(EnKS(), late={0, 3, 6}).items():
        np.testing.assert_allclose(belief.mean, means[done], rtol=0, atol=1e-9)
        np.testing.assert_allclose(covariance(belief), covariances[done], rtol=0, atol=1e-9)


def test_the_file_holds_what_was_known_then_and_what_is_known_now(tmp_path):
    filtered = [rauch_tung_striebel(done)[0][done] for done in range(CYCLES + 1)]
    smoothed, covariances = rauch_tung_striebel()
    with dafw.run(study(EnKS()), tmp_path / "run") as run:
        np.testing.assert_allclose(run["level_mean"], filtered, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(run["level_smoothed_mean"], smoothed, rtol=1e-6, atol=1e-6)
        spread = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
        np.testing.assert_allclose(run["level_smoothed_spread"], spread, rtol=1e-6)
        assert "err" not in run and "err_smoothed" not in run  # there is no truth


def test_inflation_widens_the_forecast_before_the_present_readings():
    plain, wide = beliefs(EnKS()), beliefs(EnKS(inflation=1.3))
    assert np.trace(covariance(wide[CYCLES])) > np.trace(covariance(plain[CYCLES]))


def test_no_reading_at_all_changes_nothing():
    operator = Selection(indices=np.empty(0, dtype=np.int64), covariance=np.empty(0))
    ensemble = dafw.Ensemble(MEAN + exact_draws(0, P0), SPACE)
    weights, matrix = EnKS()._transform(dafw.Observation(np.empty(0), operator), ensemble)
    np.testing.assert_allclose(weights, 0.0, atol=1e-12)
    np.testing.assert_allclose(matrix, np.eye(N), atol=1e-12)
