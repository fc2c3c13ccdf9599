"""Composing studies: only names and numbers; wrong configurations are refused in one line before any computation."""

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from hydra.core.config_store import ConfigStore

from dafw import REQUIRED, ConfigurationError, DafwError, Filter, OptionError, PluginSpec, option
from dafw.core.composition import advised, compose, single_runs, study_part
from dafw.core.experiment import merged, options_from, study_from
from dafw.core.registry import Registered, registry
from dafw.core.schemas import PluginSchemas

LITERAL = "experiment=enie2d_literal"


def study(*overrides):
    composed = study_part(compose(overrides))
    study_from(composed)
    return options_from(composed)


def test_the_default_is_the_flagship():
    default = study()
    assert (default.model["name"], default.observer["name"]) == ("ad_ins", "drone")
    assert (default.policy["name"], default.filter["name"]) == ("look_ahead", "amis")
    assert default.model["transport"]["scheme"] == "fct"


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
        (
            [LITERAL, "filter.inflatoin=2"],
            "^filter 'etkf': unknown option 'inflatoin', did you mean 'inflation'. .accepted: inflation, rotation.$",
        ),
        (["policy=stationary", "policy.sectors=3"], "^policy 'stationary': unknown option 'sectors' .accepted: none.$"),
        ([LITERAL, "policy.sector=3"], "^policy 'enie2d': unknown option 'sector', did you mean 'sectors'"),
        (["model.wall_size=3"], "^model 'ad_ins': unknown option 'wall_size', did you mean 'mesh.wall_size'"),
        (["model.mesh.wal_size=3"], "^model 'ad_ins', mesh: unknown option 'wal_size', did you mean 'wall_size'"),
        (["executor=processes", "executor.worker=3"], "^executor 'processes': unknown option 'worker', did you mean"),
        (["vehicle.sped=3"], "^study, vehicle: unknown option 'sped', did you mean 'speed'"),
        ([LITERAL, "+filter.foo=1"], "filter 'etkf': unknown option 'foo' .accepted: inflation"),
        (["filter=etfk"], "no filter 'etfk' .did you mean 'etkf'"),
        ([LITERAL, "filter.inflation=abc"], "'filter.inflation'.*'abc'"),
        ([LITERAL, "filter.inflation=0.5"], "at least 1.0, got 0.5"),
        (["cyclse=3"], "^study: unknown option 'cyclse', did you mean 'cycles'. .accepted: name, seed, members"),
        (["cycles=0"], "'cycles' must be at least 1"),
        (["seed=-1"], "'seed' must be at least 0"),
        (["experiment=nope"], "no experiment 'nope' .there are: .*enie2d"),
        (["members=1"], "at least 2 members"),
        (["truth.wind_sped=3"], "^truth: model 'ad_ins': unknown option 'wind_sped', did you mean 'wind_speed'"),
        (["+truth.wind_sped=3"], "truth: model 'ad_ins': unknown option 'wind_sped'"),
        (["free.mesh.wal_size=20"], "^free: model 'ad_ins', mesh: unknown option 'wal_size', did you mean 'wall_size'"),
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
        ([LITERAL, "policy.theta=abc"], "theta must be a number"),
        (["observer=composite"], "^observer 'composite': option 'parts' must be given$"),
        (["observer=composite", "observer.parts={}"], "^observer 'composite': option 'parts' must be given$"),
        (["model.release=[1]"], "one place"),
        (["=="], "(?i)error parsing override"),
        (["record.members=some"], "one of none, parameters, all"),
        (["seed=99999999999999999999999"], "at most"),
        (["section=[[1,2]]"], "two corners or more"),
        (["name=../../x"], "names a folder"),
        (["name="], "names a folder"),
        (["model.wind_speed=0"], "wind_speed_sd must be 0 or between"),
        (["truth.name=adx"], "there is no model 'adx' .did you mean 'ad'"),
        (
            [LITERAL, "+filter.model=${model}"],
            "^filter 'etkf': unknown option 'model' .accepted: inflation, rotation.$",
        ),
    ],
)
def test_a_wrong_request_is_refused_in_one_line(overrides, message):
    with pytest.raises(DafwError, match=message) as caught:
        study(*overrides)
    assert caught.value.exit_status == 2
    assert "\n" not in str(caught.value)


@pytest.fixture
def files(tmp_path):
    """Return a function that writes experiments into a new folder and returns the override that names the folder."""
    (tmp_path / "experiment").mkdir()

    def write(**experiments):
        for name, text in experiments.items():
            (tmp_path / "experiment" / f"{name}.yaml").write_text(f"# @package _global_\n{text}")
        return f"hydra.searchpath=[file://{tmp_path}]"

    return write


PAPER = {"name": "enie2d", "sectors": 8, "theta": 0.2, "variable": "concentration"}


def test_an_experiments_options_go_with_their_plugin_and_leave_with_it():
    assert study("policy=enie2d").policy == PAPER
    assert study("policy=stationary").policy == {"name": "stationary"}
    assert study("experiment=lorenz96", "filter=etkf").filter == {"name": "etkf", "inflation": 1.013, "rotation": True}
    # not the inflation of the experiment's filter, which has an option of the same name
    assert study("experiment=lorenz96", "filter=enkf").filter == {"name": "enkf", "inflation": 1.0}
    assert study("experiment=lorenz96_enkf", "filter=etkf", "filter.rotation=true").filter["inflation"] == 1.0
    assert study("experiment=lorenz96", "filter=enkf").observer["noise_sd"] == 1.0


def test_a_preset_of_the_same_plugin_keeps_the_options(files):
    preset = files(theirs="defaults: [{override /observer: paper_drone}, _self_]\nobserver: {samples: 3}\n")
    assert study(preset, "experiment=theirs", "observer=drone").observer["samples"] == 3
    assert study(preset, "experiment=theirs", "observer=drone").observer["noise_sd"] == study().observer["noise_sd"]


def test_the_options_of_truth_and_free_run_are_those_of_a_model():
    other = study("model=ad")
    assert (other.truth, other.free) == ({}, {}) and "wind" not in other.model
    named = study("truth.name=ad", "truth.wind_speed=3")
    assert (named.truth, named.free) == ({"name": "ad", "wind_speed": 3}, study().free)


def test_any_option_of_the_truths_model_is_accepted_without_a_plus():
    changed = study("truth.mesh.wall_size=20", "truth.wind.closure=proportional", "free.wind.closure=proportional")
    assert (changed.truth["mesh"], changed.truth["wind"]) == ({"wall_size": 20}, {"closure": "proportional"})
    assert changed.truth["wind_speed"] == 5.0 and changed.free["wind"] == {"closure": "proportional"}


@pytest.mark.parametrize("plus", ["", "+", "++"])
def test_a_plus_may_stand_before_what_is_there(plus):
    assert study(f"{plus}truth.wind_speed=6").truth["wind_speed"] == 6
    assert study(LITERAL, f"{plus}policy.theta=0.3").policy["theta"] == 0.3


@pytest.mark.parametrize("plus", ["", "+"])
def test_the_parts_of_a_composite_are_added_without_a_plus(plus):
    parts = "{drone: {name: drone}, poles: {name: stations, positions: [[0, 60]]}}"
    assert sorted(study("observer=composite", f"{plus}observer.parts={parts}").observer["parts"]) == ["drone", "poles"]
    one = study("observer=composite", f"{plus}observer.parts.one.name=drone", f"{plus}observer.parts.one.samples=3")
    assert one.observer["parts"] == {"one": {"name": "drone", "samples": 3}}


def test_an_experiment_on_top_of_another_takes_its_own_plugins(files):
    where = files(
        mine="defaults: [enie2d, {override /policy: stationary}, {override /filter: enkf}, _self_]\n"
        "filter: {inflation: 3}\ntruth: {wind_speed: 6}\n",
        plain="policy: {theta: 0.5}\n",
        coarse="model: {mesh: {wall_size: 40}}\npolicy: {theta: 0.7}\n",
        fine="defaults: [coarse, {override /model: ad}, _self_]\n",
    )
    mine = study(where, "experiment=mine")
    assert (mine.policy, mine.filter) == ({"name": "stationary"}, {"name": "enkf", "inflation": 3.0})
    assert (mine.truth["wind_speed"], mine.truth["transport"]) == (6, {"diffusion": 0.8})
    # options of the base experiment are used again with their plugin; those of the upper experiment are left out
    back = study(where, "experiment=mine", "policy=enie2d", "filter=etkf")
    assert back.policy == PAPER and back.filter["inflation"] == 1.0
    # a file that chooses no plugin sets options of the plugin that is already chosen
    assert study(where, "experiment=plain").policy["theta"] == 0.5
    assert study(where, "experiment=plain", "policy=stationary").policy == {"name": "stationary"}
    fine = study(where, "experiment=fine")
    assert (fine.model["name"], fine.model["mesh"]["wall_size"], fine.policy["theta"]) == ("ad", 40.0, 0.7)


def test_what_is_added_on_the_command_line_is_meant_for_the_plugin_there(files, tmp_path):
    (tmp_path / "tuning").mkdir()
    (tmp_path / "tuning" / "mine.yaml").write_text("# @package _global_\nfilter: {inflation: 1.5}\n")
    where = files(unused="")
    assert study(where, "experiment=lorenz96", "filter=enkf", "+tuning=mine").filter["inflation"] == 1.5
    with pytest.raises(OptionError, match=r"^tuning/mine: filter 'none': unknown option 'inflation' .accepted: none.$"):
        study(where, "filter=none", "+tuning=mine")


def test_a_mistake_in_an_experiment_is_one_line_that_names_the_file(files):
    where = files(wrong="policy: {sektors: 3}\n", stacked="defaults: [enie2d_literal, _self_]\npolicy: {sektors: 3}\n")
    for name in ("wrong", "stacked"):
        with pytest.raises(
            OptionError, match=f"^experiment/{name}: policy '(look_ahead|enie2d)': unknown option 'sektors'"
        ):
            study(where, f"experiment={name}")


def test_a_file_that_changes_is_read_again(files):
    for cycles in (3, 14):
        assert study(files(mine=f"cycles: {cycles}\n"), "experiment=mine").cycles == cycles


def test_what_is_changed_in_a_composition_is_not_in_the_next():
    for overrides in ([LITERAL], [LITERAL, "seed=1"]):
        composed = compose(overrides)
        assert composed.policy.theta == 0.2
        composed.policy.theta = composed.truth.wind_speed = 9.0


def test_plugins_are_described_when_hydra_asks_for_them():
    filters = PluginSchemas("filter")
    assert "etkf.yaml" in filters and "nonesuch.yaml" not in filters and list(filters) == ["etkf.yaml"]
    assert filters["etkf.yaml"].node.inflation == 1.0
    assert sorted(filters.keys()) == [f"{name}.yaml" for name in registry().names("filter")]


@dataclass
class WithModel(Filter):
    """A filter that has its own model."""

    model: dict[str, Any] = option({}, "the model's name and options")


@pytest.mark.parametrize("word", ["filter.model=${model}", "+filter.model=${model}"])
def test_an_option_may_be_the_whole_of_another_part(monkeypatch, word):
    spec = PluginSpec("filter", "with_model", f"{__name__}:WithModel")
    monkeypatch.setitem(registry()._plugins, ("filter", "with_model"), Registered(spec, "tests"))
    monkeypatch.setattr(ConfigStore.instance(), "repo", copy.deepcopy(ConfigStore.instance().repo))
    composed = study("experiment=lorenz96", "filter=with_model", word)
    assert composed.filter["model"] == composed.model and composed.model["size"] == 40


@dataclass
class NoDefault(Filter):
    """The author used None for 'no default'."""

    gain: float = option(None, "a gain")


@dataclass
class NoPlainType(Filter):
    """An option has a type that no configuration can hold."""

    path: Path = option(REQUIRED, "a file")


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("NoDefault", "filter 'theirs': NoDefault: option 'gain' must be of type float, got None, its own default"),
        ("NoPlainType", "filter 'theirs': option 'path' must be given"),
    ],
)
def test_a_plugin_with_impossible_options_does_not_stop_other_studies(monkeypatch, target, message):
    spec = PluginSpec("filter", "theirs", f"{__name__}:{target}")
    monkeypatch.setitem(registry()._plugins, ("filter", "theirs"), Registered(spec, "tests"))
    monkeypatch.setattr(ConfigStore.instance(), "repo", copy.deepcopy(ConfigStore.instance().repo))
    assert study().filter["name"] == "amis"
    with pytest.raises(DafwError, match=message):
        study("filter=theirs")


def test_a_model_of_another_kind_brings_the_experiments_that_have_it(files):
    error = ConfigurationError("it does not fit")
    told = "it does not fit; this study's parts are for model 'ad_ins': try experiment=lorenz96 or"
    assert str(advised(error, ["model=lorenz96"])).startswith(told)
    where = files(ring="defaults: [{override /model: linear_advection}]\n")
    told = str(advised(error, [where, "model=linear_advection", "cycles=3"]))
    assert told.endswith("try experiment=linear_advection or experiment=ring")
    assert "no experiment has model 'ad': choose observer=, policy=" in str(advised(error, ["model=ad"]))
    assert advised(error, ["experiment=lorenz96", "model=lorenz96"]) is error
    assert advised(error, ["cycles=3"]) is error


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
    placed = study("vehicle.start=[[1,2]]", "model.release=[3,4]", "section=[[0,0],[1,1]]", LITERAL, "policy.theta=1")
    assert placed.vehicle.start == [[1.0, 2.0]] and placed.model["release"] == [3.0, 4.0]


def test_a_multirun_is_expanded_to_its_jobs():
    jobs = list(single_runs(["seed=1,2", "filter=etkf,none", "cycles=3"]))
    assert jobs == [[f"seed={s}", f"filter={f}", "cycles=3"] for s in (1, 2) for f in ("etkf", "none")]
    assert len(list(single_runs(["seed=range(5)"]))) == 5


def test_changes_are_laid_over_entry_by_entry():
    base = {"a": {"b": 1, "c": 2}, "d": 3}
    assert merged(base, {"a": {"b": 9}, "e": 4}) == {"a": {"b": 9, "c": 2}, "d": 3, "e": 4}
    assert base == {"a": {"b": 1, "c": 2}, "d": 3}
