"""The iterative ensemble Kalman smoother: exact for linear problems, the most probable state for others."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from decays import (
    AMOUNTS,
    CYCLES,
    MEAN,
    P0,
    SD,
    SILENT,
    VALUES,
    Decay,
    F,
    Linear,
    N,
    covariance,
    cycles_of,
    decay_cycles,
    exact_draws,
    linear_cycles,
    listed,
    rauch_tung_striebel,
    require_moments,
)
from scipy.optimize import least_squares

from dafw import Model, StateSpace, Variable
from dafw.plugins.filters.ienks import IEnKS
from dafw.plugins.models.lorenz96 import Lorenz96
from dafw.plugins.observers.grid import Grid
from dafw.plugins.readings.twin import Twin


@pytest.mark.parametrize("variant", ["transform", "bundle"])
@pytest.mark.parametrize("iterations", [1, 10])
def test_one_iteration_is_the_kalman_filter_and_more_change_nothing(variant, iterations):
    cycles = linear_cycles(IEnKS(variant=variant, iterations=iterations))
    for done, cycle in enumerate(cycles, 1):
        means, covariances = rauch_tung_striebel(set(range(done)) - SILENT, done)
        require_moments(cycle.belief, (means[-1], covariances[-1]))


@pytest.mark.parametrize(("window", "every"), [(1, 1), (3, 1), (3, 2), (8, 1), (8, 8)])
def test_within_a_window_it_is_the_rauch_tung_striebel_smoother(window, every):
    analyses = 0
    for done, cycle in enumerate(linear_cycles(IEnKS(window=window, every=every), silent=()), 1):
        if done % every == 0:
            means, covariances = rauch_tung_striebel(range(done), done)
            assert sorted(cycle.analysis.revised) == list(range(max(0, done - window), done))
            for number, belief in {**cycle.analysis.revised, done: cycle.state.belief}.items():
                require_moments(belief.ensemble, (means[number], covariances[number]))
            analyses += 1
    assert analyses == CYCLES // every


@pytest.mark.parametrize("window", [None, CYCLES])
def test_late_readings_end_in_the_same_belief(window):
    means, covariances = rauch_tung_striebel(set(range(CYCLES)) - SILENT, CYCLES)
    last = linear_cycles(IEnKS(window=window), late={0, 3, 6})[-1]
    require_moments(last.belief, (means[-1], covariances[-1]))
    for number, belief in last.analysis.revised.items():
        require_moments(belief.ensemble, (means[number], covariances[number]))


def test_readings_that_are_means_over_several_cycles_end_in_the_exact_belief():
    """The mean of the last three states is a linear reading of the first one, so least squares has the answer."""
    span, powers = 3, np.array([np.linalg.matrix_power(F, power) for power in range(CYCLES + 1)])
    members, readings = exact_draws(N, MEAN, P0), listed(VALUES, SD, SILENT, span=float(span))
    last = cycles_of(Linear(members), IEnKS(), readings, CYCLES, N)[-1]
    rows = np.array(
        [powers[max(1, end - span + 1) : end + 1, 0].mean(axis=0) for end in range(1, CYCLES + 1)]  # what is read
    )
    seen = [cycle for cycle in range(CYCLES) if cycle not in SILENT]
    gain = P0 @ rows[seen].T @ np.linalg.inv(rows[seen] @ P0 @ rows[seen].T + SD**2 * np.eye(len(seen)))
    mean, spread = MEAN + gain @ (VALUES[seen] - rows[seen] @ MEAN), P0 - gain @ rows[seen] @ P0
    require_moments(last.belief, (powers[-1] @ mean, powers[-1] @ spread @ powers[-1].T))


# Nonlinear problems --------------------------------------------------------------------------------------------------


def most_probable(centre, prior, predict, values, sd):
    """Return the minimum of the cost, by a solver for nonlinear least squares."""
    root = np.linalg.cholesky(np.linalg.inv(prior)).T
    found = least_squares(
        lambda x: np.concatenate([root @ (x - centre), (values - predict(x)) / sd]), centre, xtol=1e-15, ftol=1e-15
    )
    return found.x


def test_the_bundle_variant_finds_the_most_probable_start():
    logs = exact_draws(6, np.array([0.3, -1.5]), np.diag([0.09, 0.25]))
    filter_ = IEnKS(window=6, every=6, variant="bundle", epsilon=1e-6, tolerance=1e-9, iterations=30)
    last = decay_cycles(filter_, Decay(start=np.exp(logs)), members=6)[-1]
    times = np.arange(1, 7)
    expected = most_probable(
        logs.mean(axis=0),
        np.cov(logs, rowvar=False),
        lambda z: np.exp(z[0] - np.exp(z[1]) * times),
        AMOUNTS,
        0.02,
    )
    found = np.log(last.analysis.revised[0].ensemble.mean)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)
    assert np.abs(found - logs.mean(axis=0)).max() > 0.5  # the first guess was far from it
    # Its spread is that of the Gauss-Newton Hessian at the minimum.
    rows = np.exp(expected[0] - np.exp(expected[1]) * times)
    jacobian = np.column_stack([rows, -np.exp(expected[1]) * times * rows])
    hessian = np.linalg.inv(np.cov(logs, rowvar=False)) + jacobian.T @ jacobian / 0.02**2
    spread = covariance(last.analysis.revised[0].ensemble)
    np.testing.assert_allclose(spread, np.linalg.inv(hessian), rtol=1e-5)


@dataclass
class Bent(Model):
    """The second number is the arc tangent of the first, from whose flat ends Gauss-Newton steps go far too far."""

    start: np.ndarray
    dt: float = 1.0
    space: StateSpace = field(default_factory=lambda: StateSpace([Variable("bent", 1), Variable("straight", 1)]))

    def initial(self, n_members, rng):
        return self.start

    def step(self, members, t, rng):
        return np.column_stack([np.arctan(members[:, 1]), members[:, 1]])


def bent_start(variant="bundle", **options):
    """Return the start as found, and its cost relative to the first guess's."""
    centre, sd = 4.0, 0.01
    start = np.column_stack([np.zeros(5), exact_draws(5, np.array([centre]), np.array([[100.0]]))])
    filter_ = IEnKS(window=1, estimate=["straight"], variant=variant, **options)
    cycle = cycles_of(Bent(start), filter_, listed([0.0], sd), 1, 5)[-1]

    def cost(x):
        return (x - centre) ** 2 / 100.0 + (np.arctan(x) / sd) ** 2

    found = float(cycle.analysis.revised[0].ensemble.mean[1])
    expected = most_probable(np.array([centre]), np.array([[100.0]]), np.arctan, np.zeros(1), sd)
    return found, float(expected[0]), cost(found) / cost(centre)


def test_a_step_that_goes_too_far_is_halved():
    found, expected, _ = bent_start(iterations=30, tolerance=1e-10)
    assert found == pytest.approx(expected, abs=1e-7)


def test_members_far_apart_lead_near_the_most_probable_start_from_where_their_mean_is_no_guide():
    found, expected, cost = bent_start("transform", iterations=30)
    assert cost < 1e-3 and abs(found - expected) < 0.1


@pytest.mark.parametrize("iterations", [2, 3])
def test_a_search_cut_short_is_no_worse_than_the_first_guess(iterations):
    assert bent_start(iterations=iterations)[2] < 1.0 + 1e-6


def test_the_search_ends_when_it_has_arrived():
    runs = [cycle.analysis.diagnostics["model_runs"].values for cycle in linear_cycles(IEnKS(iterations=50), silent=())]
    assert runs == [3] * CYCLES  # an iteration, one that does not move, and the run to the present


def test_a_window_follows_chaos_of_which_half_is_seen():
    model = Lorenz96(size=10, first_guess_sd=0.5)
    cycles = cycles_of(
        model,
        IEnKS(window=4, inflation=1.05),
        Twin(),
        60,
        12,
        observer=Grid(variable="x", stride=2, noise_sd=0.3),
        truth=model,
        seed=1000,
    )
    errors = [np.sqrt(np.mean((cycle.belief.mean - cycle.truth.members[0]) ** 2)) for cycle in cycles]
    assert np.mean(errors[20:]) < 0.3  # less than the error of a reading, in what is not seen as well
