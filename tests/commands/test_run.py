"""``dafw run``: every way to choose a study composes the same study; parts that do not fit are refused with a hint."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

import dafw
from dafw.commands import main

MINE = """\
# @package _global_
defaults: [lorenz96, {override /filter: enkf}, _self_]
name: mine
members: 5
cycles: 2
pictures: false
filter: {inflation: 1.25}
"""
WORDS = ["experiment=mine", "filter=etkf"]
CHOSEN = {"name": "etkf", "inflation": 1.013, "rotation": True}  # of the experiment below


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working folder, next to a folder with an experiment."""
    (tmp_path / "my" / "experiment").mkdir(parents=True)
    (tmp_path / "my" / "experiment" / "mine.yaml").write_text(MINE)
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return tmp_path / "work"


def composed(run: Path) -> dict:
    """Return the configuration that Hydra stored for a run."""
    return yaml.safe_load((run / ".hydra" / "config.yaml").read_text())


@pytest.mark.parametrize("more", [[], ["-m"], ["-m", "hydra/launcher=cores", "hydra.launcher.n_jobs=1"]])
def test_every_launch_composes_the_same_study(folder, more):
    assert main(["run", "--config-dir", "../my", *more, *WORDS]) == 0
    (noted,) = folder.glob("outputs/**/.hydra")
    assert composed(noted.parent)["filter"] == CHOSEN


def test_the_python_call_composes_the_same_study(folder):
    with dafw.run(["hydra.searchpath=[file://../my]", *WORDS]) as run:
        assert composed(Path(run.attrs["folder"]))["filter"] == CHOSEN


def test_the_shown_configuration_is_the_same(folder, capsys):
    assert main(["run", "--config-dir", "../my", *WORDS, "--cfg", "job"]) == 0
    assert yaml.safe_load(capsys.readouterr().out)["filter"] == CHOSEN


def test_the_jobs_of_a_multirun_have_their_own_options(folder, capsys):
    words = ["run", "--config-dir", "../my", "-m", "experiment=mine,lorenz96", "filter=enkf,etkf", "cycles=1"]
    assert main([*words, "pictures=false", "members=5"]) == 0
    sweep = Path(capsys.readouterr().out.splitlines()[-1])
    assert sweep.parent.name == "mine"
    found = {(c["name"], c["filter"]["name"]): c["filter"]["inflation"] for c in map(composed, sweep.glob("*/"))}
    assert found == {
        ("mine", "enkf"): 1.25,
        ("mine", "etkf"): 1.013,
        ("lorenz96", "enkf"): 1.0,
        ("lorenz96", "etkf"): 1.013,
    }


def test_an_option_of_swept_plugins_is_no_matter_of_the_one_they_replace(folder):
    words = ["run", "-m", "experiment=lorenz96_enkf", "filter=etkf", "filter.rotation=true,false", "cycles=1"]
    assert main([*words, "pictures=false"]) == 0
    assert len(list(folder.glob("outputs/*/*/*/run.nc"))) == 2


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["model=lorenz96"],
            "this study's parts are for model 'ad_ins': try experiment=lorenz96 or experiment=lorenz96_",
        ),
        (["-m", "model=ad,lorenz96", "cycles=1"], "try experiment=lorenz96 or experiment=lorenz96_enkf"),
        (["-m", "filter=etkf,enkf", "filter.rotation=true"], "filter 'enkf': unknown option 'rotation' (accepted: inf"),
        (["policy=stationary", "policy.theta=0.3"], "policy 'stationary': unknown option 'theta' (accepted: none)"),
        (["policy=stationary", "policy.theta=0.3", "--cfg", "job"], "policy 'stationary': unknown option 'theta'"),
        (["--cfg", "job", "-m"], "expected only one of"),
        (["--resolve"], "--resolve goes with --cfg"),
        (["hydra.mode=MULTIRUN"], "hydra.mode follows the command"),
        (["--experimental-rerun", "config.pickle"], "would run what a file says"),
    ],
)
def test_a_wrong_request_is_one_line_and_status_2(folder, capsys, words, message):
    assert main(["run", *words]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1 and message in captured.err, captured
    assert list(folder.iterdir()) == []


def test_help_has_no_code_of_an_experiment_run(folder, capsys):
    evil = "hydra: {job_logging: {formatters: {x: {(): os.system}}}}\n"
    (folder.parent / "my" / "experiment" / "evil.yaml").write_text(f"# @package _global_\n{evil}")
    assert main(["run", "--config-dir", "../my", "experiment=evil", "--help"]) == 2
    assert "may not name code to be run" in capsys.readouterr().err


def test_the_python_call_has_the_hint_too(folder):
    with pytest.raises(dafw.ConfigurationError, match=r"try experiment=lorenz96 or experiment=lorenz96_enkf$"):
        dafw.run(["model=lorenz96"])
    assert list(folder.iterdir()) == []
