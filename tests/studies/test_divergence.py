"""A belief that diverges: one warning, and then an error that names the number that is too large."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import dafw
from dafw import Analysis, DivergenceError, Filter, Model, StateSpace, Study, Variable
from dafw.core.plugin import SENSELESS
from dafw.core.registry import registry
from dafw.plugins.filters.none import NoFilter
from dafw.plugins.models.dispersion.plausible import largest_concentration, strongest_wind


def summary(folder):
    return json.loads(Path(folder, "summary.json").read_text())


class Doubling(Model):
    """Two numbers; one doubles in every step."""

    space = StateSpace([Variable("still", 1), Variable("growing", 2, plausible=10.0)])
    dt = 1.0

    def initial(self, n_members, rng):
        return np.ones((n_members, 3)) + 0.1 * np.arange(n_members)[:, np.newaxis]

    def step(self, members, t, rng):
        return members * [1.0, 1.0, 2.0]


class Still(Doubling):
    """A model whose numbers do not change."""

    def step(self, members, t, rng):
        return members


class Pushing(Filter):
    """Moves the last number of member 1 far away."""

    def analyse(self, forecast, predicted, observation, rng):
        members = forecast.members.copy()
        members[1, 2] *= 20.0
        return Analysis(members)


class Singular(Filter):
    """A filter whose linear algebra fails in the third analysis."""

    def analyse(self, forecast, predicted, observation, rng):
        if forecast.time == 3.0:
            np.linalg.cholesky(-np.eye(2))
        return Analysis(forecast.members)


def study(model, filter_):
    observer = registry().create("observer", {"name": "grid", "variable": "growing"})
    return Study(model=model, truth=Still(), filter=filter_, observer=observer, members=3, cycles=40)


def test_a_model_that_runs_away_is_warned_of_once_and_ended(tmp_path, capsys):
    with pytest.raises(DivergenceError) as caught:
        dafw.run(study(Doubling(), NoFilter()), tmp_path / "run")
    # 1.2 times 2^4 is above 10, 1.2 times 2^14 above a thousand times 10.
    assert str(caught.value).startswith(
        "at t = 13 s, phase 'forecast': member 2: model 'Doubling': the numbers have diverged: 'growing' at "
        "node 1, 19660.8, is 1.97e+03 times the largest value that is plausible; 13 of 40 cycles are kept in "
    )
    warning = "t = 4 s: filter 'NoFilter' has diverged: 'growing' at node 1 of member 2 is 19.2, more than the model"
    assert capsys.readouterr().err.count("has diverged") == 1
    log = (tmp_path / "run" / "run.log").read_text()
    assert log.count("WARNING") == 1 and warning in log
    found = summary(tmp_path / "run")
    assert (found["status"], found["cycles"], found["diverged_at"]) == ("failed", 13, 4.0)
    assert "member 2: model 'Doubling': the numbers" in found["error"]


def test_a_filter_that_runs_away_is_named(tmp_path):
    with pytest.raises(DivergenceError, match=r"at t = 3 s, phase 'analyse': member 1: filter 'Pushing': .*, 176000, "):
        dafw.run(study(Still(), Pushing()), tmp_path / "run")
    assert summary(tmp_path / "run")["diverged_at"] == 1.0


def test_linear_algebra_that_fails_says_where_the_forecast_is_most_extreme(tmp_path):
    expected = (
        r"at t = 2 s, phase 'analyse': filter 'Singular': its linear algebra failed \(Matrix is not positive "
        r"definite\); the forecast's most extreme number is 'growing' at node 1 of member 2: 9\.6; "
        r"2 of 40 cycles are kept"
    )
    with pytest.raises(DivergenceError, match=expected):
        dafw.run(study(Doubling(), Singular()), tmp_path / "run")


def test_a_belief_that_does_not_diverge_is_not_said_to(tmp_path, capsys):
    with dafw.run(study(Still(), NoFilter()), tmp_path / "run"):
        assert summary(tmp_path / "run")["diverged_at"] is None
    assert "diverged" not in capsys.readouterr().err + (tmp_path / "run" / "run.log").read_text()


QUICK = [
    "model=ad", "observer=drone", "members=4", "pictures=false", "model.mesh.wall_size=40", "model.mesh.far_size=60",
    "model.release=[250,40]", "model.wind_speed=4", "model.wind_speed_sd=2", "model.noise=0.1", "seed=1",
]  # fmt: skip
TRUTH = ["+truth.wind_speed=5", "+truth.wind_speed_sd=0", "+truth.noise=0", "+free.wind_speed_sd=0", "+free.noise=0"]


def gas(cycles, place):
    words = [*QUICK, *TRUTH, "+vehicle.start=[[250,0]]", f"cycles={cycles}"]
    return dafw.run(["~experiment", *words], place)


def test_the_noise_of_a_healthy_run_is_no_divergence(tmp_path):
    with gas(30, tmp_path / "run"):
        assert summary(tmp_path / "run")["diverged_at"] is None


def test_a_cloud_that_grows_without_end_is_ended_long_before_numbers_overflow(tmp_path, capsys):
    """The literal filter makes the belief grow tenfold every hundred cycles. Every warning is an error here."""
    with pytest.raises(DivergenceError) as caught:
        gas(2000, tmp_path / "run")
    said = re.search(
        r"^at t = \d+ s, phase '\w+': member [0-3]: \w+ '\w+': the numbers have diverged: 'concentration' at "
        r"node \d+, ([0-9.e+]+), is",
        str(caught.value),
    )
    found = summary(tmp_path / "run")
    assert said and float(said[1]) < 1e9
    assert found["status"] == "failed" and 30 < found["diverged_at"] < found["cycles"]
    assert capsys.readouterr().err.count("has diverged") == 1


def test_the_bounds_grow_with_the_noise_and_with_the_first_guess():
    assert 20.0 == largest_concentration(0.0) < 50.0 < largest_concentration(0.1) < 60.0 < largest_concentration(0.2)
    assert strongest_wind(2.5, 3.0) == 100.0 and strongest_wind(20.0, 5.0) == 250.0
    assert SENSELESS == 1e3
