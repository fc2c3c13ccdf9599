"""Composing studies: names and numbers only, everything wrong refused in one line before anything is computed."""

import pytest

from dafw import ConfigurationError, DafwError
from dafw.core.composition import compose, single_runs, study_part
from dafw.core.experiment import merged, options_from, study_from


def study(*overrides):
    composed = study_part(compose(overrides))
    study_from(composed)
    return options_from(composed)


def test_the_default_is_the_flagship():
    default = study()
    assert (default.model["name"], default.observer["name"]) == ("ad_ins", "drone")
    assert (default.policy["name"], default.filter["name"]) == ("enie2d", "etkf")


def test_the_papers_study_holds_the_papers_values():
    paper = study("experiment=enie2d_paper")
    assert (paper.members, paper.cycles, paper.model["dt"]) == (10, 100, 1.0)
    model, truth = paper.model, paper.truth
    assert (truth["wind_speed"], truth["transport"]["diffusion"]) == (5.0, 0.8)
    assert truth["wind_direction"] == pytest.approx(3.141592653589793)
    assert (model["wind_speed"], model["wind_speed_sd"], model["transport"]["diffusion"]) == (2.5, 3.0, 0.4)
    assert (model["wind_direction"], model["wind_direction_sd"]) == pytest.approx((4.71238898, 1.57079633))
    assert (model["speed_threshold"], model["direction_threshold"], model["noise"]) == (0.10, 0.05, 0.1)
    assert paper.policy == {"name": "enie2d", "sectors": 8, "theta": 0.2, "variable": "concentration"}
    assert (paper.observer["noise_sd"], paper.observer["assumed_variance"]) == (1e-3, 1e-3)
    assert (paper.vehicle.speed, len(paper.vehicle.start)) == (10.0, 1)
    assert paper.filter["inflation"] == 1.0


def test_one_word_changes_the_filter():
    assert study("filter=none").filter == {"name": "none"}


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["filter.inflatoin=2"], "unknown option 'filter.inflatoin' .accepted: inflation"),
        (["+filter.foo=1"], "filter 'etkf': unknown option 'foo' .accepted: inflation"),
        (["filter=etfk"], "no filter 'etfk' .did you mean 'etkf'"),
        (["filter.inflation=abc"], "'filter.inflation'.*'abc'"),
        (["filter.inflation=0.5"], "at least 1.0, got 0.5"),
        (["cyclse=3"], "unknown option 'cyclse' .accepted: name, seed, members, cycles"),
        (["cycles=0"], "'cycles' must be at least 1"),
        (["seed=-1"], "'seed' must be at least 0"),
        (["experiment=nope"], "no experiment 'nope' .there are: .*enie2d"),
        (["members=1"], "at least 2 members"),
        (["+truth.wind_sped=3"], "truth: model 'ad_ins': unknown option 'wind_sped'"),
        (["truth.transport.diffusion=-1"], "at least 0"),
        (["model.wind.closure=magic"], "one of constant, proportional"),
        (["model.wind.solver=null"], "^option 'model.wind.solver' must have a value, got null$"),
        (
            ["model.wind.basis=newest"],
            "^'model.wind.basis' is a group of options, expected .*OPTION=VALUE, got newest$",
        ),
        (["model.wind.basis.directions=1"], "'directions' must be at least 4, got 1"),
        (["model.wind.basis.tolerance=5"], "'tolerance' must be at most 1.0, got 5.0"),
        (["vehicle.start=[[1,2,3]]"], "vehicle.start must be"),
        (["policy.theta=abc"], "theta must be a number"),
        (["observer=composite"], "at least one observer"),
        (["model.release=[1]"], "one place"),
        (["=="], "(?i)error parsing override"),
        (["record.members=some"], "one of none, parameters, all"),
        (["seed=99999999999999999999999"], "at most"),
        (["section=[[1,2]]"], "two corners or more"),
        (["name=../../x"], "names a folder"),
        (["name="], "names a folder"),
        (["model.wind_speed=0"], "wind_speed_sd must be 0 or between"),
        (["truth.name=ad"], r"write \+truth.name"),
    ],
)
def test_a_wrong_request_is_refused_in_one_line(overrides, message):
    with pytest.raises(DafwError, match=message) as caught:
        study(*overrides)
    assert caught.value.exit_status == 2
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "override",
    [
        "+hydra.callbacks.x._target_=os.system",
        "+model.site._target_=os.system",
        "+hydra.job_logging.handlers.x.class=subprocess.Popen",
        "hydra.launcher._target_=subprocess.Popen",
        "+hydra.callbacks.x._target_=logging.os.mkdir",
        "+hydra.callbacks.x._target_=hydra.core.utils.run_job",
        "+hydra.callbacks.x._target_=hydra_plugins.acme.LauncherOfEvil.os.system",
    ],
)
def test_no_configuration_has_code_of_its_own_run(override):
    with pytest.raises(ConfigurationError, match="may not name code to be run"):
        compose([override])


@pytest.mark.parametrize(
    "content",
    [
        "hydra: {job_logging: {formatters: {x: {(): os.system}}}}",
        "hydra: {callbacks: {x: {_target_: subprocess.Popen, args: [touch, pwned]}}}",
        "truth: {x: {_target_: os.system}}",
        "section: [{_target_: os.system}]",
    ],
)
def test_a_file_from_elsewhere_cannot_have_code_run(tmp_path, content):
    (tmp_path / "experiment").mkdir()
    (tmp_path / "experiment" / "evil.yaml").write_text(f"# @package _global_\n{content}\n")
    with pytest.raises(ConfigurationError, match="may not name code to be run"):
        compose([f"hydra.searchpath=[file://{tmp_path}]", "experiment=evil"])


def test_whole_numbers_pass_for_real_ones():
    placed = study("vehicle.start=[[1,2]]", "model.release=[3,4]", "section=[[0,0],[1,1]]", "policy.theta=1")
    assert placed.vehicle.start == [[1.0, 2.0]] and placed.model["release"] == [3.0, 4.0]


def test_a_multirun_is_expanded_to_its_jobs():
    jobs = list(single_runs(["seed=1,2", "filter=etkf,none", "cycles=3"]))
    assert jobs == [[f"seed={s}", f"filter={f}", "cycles=3"] for s in (1, 2) for f in ("etkf", "none")]
    assert len(list(single_runs(["seed=range(5)"]))) == 5


def test_changes_are_laid_over_entry_by_entry():
    base = {"a": {"b": 1, "c": 2}, "d": 3}
    assert merged(base, {"a": {"b": 9}, "e": 4}) == {"a": {"b": 9, "c": 2}, "d": 3, "e": 4}
    assert base == {"a": {"b": 1, "c": 2}, "d": 3}
