"""Lorenz-96: its equation, the order of its scheme, and the scores of the literature in the framework's own loop."""

import json

import numpy as np
import pytest

import dafw
from dafw.core.rng import Streams
from dafw.plugins.models.lorenz96 import Lorenz96, tendency

STREAMS = Streams(0).members("model", 0)


def test_tendency_is_the_equation():
    x = np.random.default_rng(0).normal(2.0, 4.0, (3, 7))
    found = tendency(x.T, 5.0).T
    for member in range(3):
        for i in range(7):
            u = x[member]
            expected = (u[(i + 1) % 7] - u[(i - 2) % 7]) * u[(i - 1) % 7] - u[i] + 5.0
            assert found[member, i] == pytest.approx(expected, abs=1e-12)


def test_rest_stays_at_rest():
    rest = np.full((1, 40), 8.0)
    assert np.array_equal(Lorenz96().step(rest, 0.0, STREAMS), rest)


def test_scheme_is_of_fourth_order():
    start = Lorenz96().initial(1, STREAMS)

    def after(n_steps):
        model, x = Lorenz96(dt=0.4 / n_steps), start
        for _ in range(n_steps):
            x = model.step(x, 0.0, STREAMS)
        return x

    reference = after(1024)
    errors = [np.abs(after(n) - reference).max() for n in (16, 32, 64)]
    assert np.all(np.log2(np.divide(errors[:-1], errors[1:])) > 3.8)


def test_members_do_not_see_each_other():
    model = Lorenz96()
    members = model.initial(5, STREAMS)
    together = model.step(members, 0.0, STREAMS)
    assert np.array_equal(together, np.concatenate([model.step(one[np.newaxis], 0.0, STREAMS) for one in members]))


@pytest.mark.parametrize(("size", "forcing"), [(4, 0.0), (4, 30.0), (5, 8.0), (40, 8.0), (40, -8.0), (60, 12.0)])
@pytest.mark.parametrize("spinup", [0, 400])
def test_no_state_is_larger_than_what_is_said_to_be_plausible(size, forcing, spinup):
    model = Lorenz96(size=size, forcing=forcing, dt=0.01, first_guess_sd=3.0, spinup=spinup)
    x = model.initial(50, STREAMS)
    largest = model.space.excess(x)
    for _ in range(500):
        x = model.step(x, 0.0, STREAMS)
        largest = max(largest, model.space.excess(x))
    assert 0.0 < largest < 1.0


def test_first_guess_is_around_one_state_of_the_attractor():
    model = Lorenz96(first_guess_sd=0.5)
    centre = Lorenz96(first_guess_sd=0.0).initial(1, Streams(7).members("another", 0))
    draws = model.initial(2000, STREAMS) - centre
    assert abs(draws.std() - 0.5) < 5 * 0.5 / np.sqrt(2 * draws.size)
    assert 3.0 < centre.std() < 5.0  # the climatological standard deviation is 3.6


def test_a_run_keeps_the_conventions_of_every_run(tmp_path):
    run = dafw.run(["experiment=lorenz96", "cycles=40", "pictures=false", f"hydra.run.dir={tmp_path}/run"])
    with run:
        assert run.sizes["time"] == 41
        assert run.attrs["scored_variable"] == "x"
        for stage in ("truth", "free", "forecast_mean", "forecast_spread", "mean", "spread"):
            assert run[f"x_{stage}"].dims == ("time", "node")
        rmse = np.sqrt(((run["x_mean"] - run["x_truth"]) ** 2).mean("node"))
        spread = np.sqrt((run["x_spread"] ** 2).mean("node"))
        np.testing.assert_allclose(run["rmse"], rmse, rtol=1e-4)
        np.testing.assert_allclose(run["spread"], spread, rtol=1e-4)
        np.testing.assert_allclose(run["time"], 0.05 * np.arange(41))
        np.testing.assert_array_equal(run["observation_node"][1:], np.tile(np.arange(40), (40, 1)))
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["status"] == "complete"


@pytest.mark.parametrize(("experiment", "published"), [("lorenz96", 0.18), ("lorenz96_enkf", 0.22)])
def test_scores_of_the_literature(tmp_path, experiment, published):
    # Three seeds of the ten that `python -m benchmarks l96.etkf_rmse l96.enkf_rmse` takes.
    scores = []
    for seed in range(3):
        folder = f"hydra.run.dir={tmp_path}/{seed}"
        with dafw.run([f"experiment={experiment}", f"seed={seed}", "free=null", "pictures=false", folder]) as run:
            scores.append(float(run["rmse"][401:].mean()))
    assert np.median(scores) == pytest.approx(published, rel=0.1)
