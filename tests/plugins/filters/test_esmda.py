"""ES-MDA: its coefficients and its inversion, and its answer on a linear problem."""

import numpy as np
import pytest
from decays import CYCLES, MEAN, P0, Decay, covariance, decay_cycles, linear_cycles, listed, rauch_tung_striebel

from dafw import Observation, Selection, Study
from dafw.core.cycle import start
from dafw.core.window import PastCycle, Window
from dafw.plugins.filters.esmda import ESMDA, coefficients, gain


@pytest.mark.parametrize("n_steps", [1, 4, 16])
@pytest.mark.parametrize("decrease", [1.0, 1.5, 4.0])
def test_the_inverses_of_the_coefficients_add_up_to_one(n_steps, decrease):
    alpha = coefficients(n_steps, decrease)
    assert np.sum(1.0 / alpha) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(alpha[:-1] / alpha[1:], decrease, rtol=1e-12)
    if decrease == 1.0:
        np.testing.assert_array_equal(alpha, n_steps)


@pytest.mark.parametrize("m", [3, 12])
def test_the_gain_is_that_of_the_space_of_the_readings(m):
    Y, alpha = np.random.default_rng(1).standard_normal((6, m)), 2.5  # noqa: N806
    expected = np.linalg.solve(Y.T @ Y + 5 * alpha * np.eye(m), Y.T)
    np.testing.assert_allclose(gain(Y, alpha, 1.0), expected, rtol=0, atol=1e-13)


def test_with_less_energy_the_gain_is_that_of_the_leading_singular_values():
    rng = np.random.default_rng(2)
    U, V = np.linalg.qr(rng.standard_normal((5, 3)))[0], np.linalg.qr(rng.standard_normal((4, 3)))[0]  # noqa: N806
    leading = (U[:, :2] * [3.0, 2.0]) @ V[:, :2].T
    Y = leading + 1.0 * np.outer(U[:, 2], V[:, 2])  # noqa: N806
    for energy, kept in ((0.9, leading), (13.0 / 14.0 + 1e-9, Y), (1.0, Y), (0.5, 3.0 * np.outer(U[:, 0], V[:, 0]))):
        np.testing.assert_allclose(gain(Y, 1.0, energy), gain(kept, 1.0, 1.0), rtol=0, atol=1e-13)


def test_predictions_that_all_agree_change_nothing():
    np.testing.assert_array_equal(gain(np.zeros((4, 3)), 1.0, 0.9), np.zeros((3, 4)))


@pytest.mark.parametrize("decrease", [1.0, 2.0])
def test_many_members_have_the_moments_of_the_smoother(decrease):
    n_members = 20_000
    draws = np.random.default_rng(5).standard_normal((n_members, 2)) @ np.linalg.cholesky(P0).T
    draws = MEAN + draws - draws.mean(axis=0)
    last = linear_cycles(ESMDA(window=CYCLES, every=CYCLES, decrease=decrease), silent=(), members=draws)[-1]
    means, covariances = rauch_tung_striebel(range(CYCLES), CYCLES)
    for number, belief in {**last.analysis.revised, CYCLES: last.state.belief}.items():
        spread = np.sqrt(np.diag(covariances[number]))
        # Sampling errors of a mean and of a covariance, in units of the spread: 1 / sqrt(N) and sqrt(2 / N). The first
        # guess's covariance and the draws of four steps each add their own.
        off = np.abs(belief.ensemble.mean - means[number]) / spread
        assert off.max() < 5.0 / np.sqrt(n_members)
        off = np.abs(covariance(belief.ensemble) - covariances[number]) / np.outer(spread, spread)
        assert off.max() < 5.0 * np.sqrt(2.0 * 2.0 / n_members)


def test_one_step_is_the_stochastic_update_in_the_space_of_the_readings():
    n_members, R = 7, np.array([[0.04, 0.01], [0.01, 0.09]])  # noqa: N806
    model = Decay()
    study = Study(model=model, filter=ESMDA(), members=n_members, cycles=1, readings=listed([1.0], 1.0))
    parts, vehicle = study.prepare()
    first = start(parts, n_members, vehicle).belief
    operator = Selection(indices=np.array([0, 1]), covariance=R)
    values = np.array([0.8, 0.4])
    run = parts.rerun(first, 0, 1)
    predicted = operator.apply(run.forecast.ensemble.members)
    past = PastCycle(0, first, Observation(values, operator, 1.0))
    window = Window((past,), run.forecast, predicted, (), None, parts.rerun)
    found = ESMDA(iterations=1).look_back(window, np.random.default_rng(9))

    z = np.log(first.ensemble.members)
    draws = np.random.default_rng(9).standard_normal((n_members, 2)) @ np.linalg.cholesky(R).T
    joint = np.cov(z, predicted, rowvar=False)
    K = joint[:2, 2:] @ np.linalg.inv(joint[2:, 2:] + R)  # noqa: N806
    moved = np.exp(z + (values + draws - predicted) @ K.T)
    np.testing.assert_allclose(found.members[:, 1], moved[:, 1], rtol=1e-12)
    np.testing.assert_allclose(found.members[:, 0], moved[:, 0] * np.exp(-moved[:, 1]), rtol=1e-12)


def test_steps_between_runs_find_what_one_step_misses():
    def misfit(iterations):
        last = decay_cycles(ESMDA(every=6, iterations=iterations), members=40, sd=0.005, seed=1000)[-1]
        return last.analysis.diagnostics["mismatch"].values

    one, eight = misfit(1), misfit(8)
    assert eight < 0.2 * one and eight < 3.0
