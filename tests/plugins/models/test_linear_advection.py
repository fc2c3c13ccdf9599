"""Linear advection: exact at Courant number 1, first order below; the moments of its first guess."""

import numpy as np
import pytest

import dafw
from dafw.core.errors import OptionError
from dafw.core.rng import Streams
from dafw.plugins.models.linear_advection import LinearAdvection

STREAMS = Streams(0).members("model", 0)


def moved(model, u, n_steps):
    for number in range(n_steps):
        u = model.step(u, number * model.dt, STREAMS)
    return u


@pytest.mark.parametrize(("speed", "to"), [(2.0, 1), (-2.0, -1)])
def test_courant_number_1_moves_the_numbers_by_a_cell_without_rounding(speed, to):
    model = LinearAdvection(cells=10, length=20.0, speed=speed)
    u = np.random.default_rng(0).normal(size=(3, 10))
    assert np.array_equal(model.step(u, 0.0, STREAMS), np.roll(u, to, axis=1))
    assert np.array_equal(moved(model, u, 10), u)


def test_upwind_is_of_first_order_towards_the_exact_solution():
    cells = np.array([100, 200, 400, 800])
    errors = []
    for n in cells:
        model = LinearAdvection(cells=int(n), length=10.0, speed=1.0, dt=0.5 * 10.0 / n)
        found = moved(model, np.sin(2 * np.pi * model.x / 10.0)[np.newaxis], int(n))
        exact = np.sin(2 * np.pi * (model.x - n * model.dt) / 10.0)
        errors.append(np.sqrt(np.mean((found[0] - exact) ** 2)))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all((orders > 0.95) & (orders < 1.05))


def test_upwind_keeps_the_sum_and_makes_no_new_extremes():
    model = LinearAdvection(cells=30, length=30.0, dt=0.7)
    u = np.random.default_rng(1).normal(size=(4, 30))
    after = moved(model, u, 25)
    np.testing.assert_allclose(after.sum(axis=1), u.sum(axis=1), rtol=0, atol=1e-12)
    assert np.all(after.max(axis=1) <= u.max(axis=1))
    assert np.all(after.min(axis=1) >= u.min(axis=1))


def test_model_errors_are_as_correlated_as_the_option_says():
    model = LinearAdvection(cells=4, length=4.0, speed=0.0, error_sd=0.5, error_correlation=0.8)
    streams, n_members = Streams(0), 4000
    members, memory, errors = np.zeros((n_members, 4)), model.initial_memory(np.zeros((n_members, 4))), []
    for cycle in range(12):
        step = model.step_with_memory(members, memory, float(cycle), streams.members("error", cycle))
        errors.append((step.members - members).ravel())
        members, memory = step.members, step.memory
    # The error is zero at the start; its variance grows towards sd^2 as 1 - a^(2 k).
    np.testing.assert_allclose(np.var(errors[0]), 0.25 * (1.0 - 0.8**2), rtol=0.05)
    np.testing.assert_allclose(np.var(errors[-1]), 0.25 * (1.0 - 0.8**24), rtol=0.05)
    assert np.corrcoef(errors[-2], errors[-1])[0, 1] == pytest.approx(0.8, abs=0.02)


def test_an_error_without_correlation_is_remembered_by_nobody():
    model, members = LinearAdvection(cells=4, length=4.0, error_sd=0.5), np.ones((2, 4))
    assert model.initial_memory(members) is None
    step = model.step_with_memory(members, None, 0.0, STREAMS)
    assert step.memory is None and np.array_equal(step.members, model.step(members, 0.0, STREAMS))


def test_an_error_that_never_changes_is_refused():
    with pytest.raises(OptionError, match="error_correlation must be below 1, got 1"):
        LinearAdvection(error_correlation=1.0)


def test_a_courant_number_above_1_is_refused():
    with pytest.raises(OptionError, match=r"Courant number .* at most 1, got 2"):
        LinearAdvection(cells=10, length=10.0, dt=2.0)


def test_first_guess_has_zero_mean_unit_variance_and_no_shorter_waves():
    model = LinearAdvection(cells=32, length=32.0, waves=3)
    draws = model.initial(4000, STREAMS)
    standard_error = np.sqrt(2 / len(draws))
    np.testing.assert_allclose(draws.mean(axis=0), 0.0, rtol=0, atol=5 * standard_error)
    np.testing.assert_allclose(draws.var(axis=0), 1.0, rtol=0, atol=5 * standard_error)
    np.testing.assert_allclose(np.fft.rfft(draws, axis=1)[:, 4:], 0.0, rtol=0, atol=1e-10)


def test_model_error_is_drawn_by_member():
    quiet, noisy = LinearAdvection(cells=50), LinearAdvection(cells=50, error_sd=0.1)
    u = np.zeros((400, 50))
    error = noisy.step(u, 0.0, STREAMS) - quiet.step(u, 0.0, STREAMS)
    assert abs(error.std() - 0.1) < 5 * 0.1 / np.sqrt(2 * error.size)
    assert np.array_equal(noisy.step(u[:3], 0.0, STREAMS), noisy.step(u, 0.0, STREAMS)[:3])


def test_a_run_places_its_readings_and_finds_the_waves(tmp_path):
    run = dafw.run(["experiment=linear_advection", "cycles=40", "pictures=false", f"hydra.run.dir={tmp_path}/run"])
    with run:
        np.testing.assert_array_equal(run["node_x"], np.arange(40.0))
        np.testing.assert_array_equal(run["observation_x"][1:], np.tile([0.0, 10.0, 20.0, 30.0], (40, 1)))
        # After one circuit the truth is where it began, and the belief agrees with it.
        np.testing.assert_array_equal(run["u_truth"][40], run["u_truth"][0])
        assert run["rmse"][40] < 0.2 < 0.5 < run["rmse"][0]


def test_numbers_grow_beyond_what_is_plausible_only_by_model_errors():
    model = LinearAdvection(cells=50, speed=0.5)
    x = model.initial(200, STREAMS)
    assert model.space.excess(moved(model, x, 100)) <= model.space.excess(x) < 0.8
    assert LinearAdvection(error_sd=0.1).space["u"].plausible == np.inf
