"""``dafw study``: it runs what is missing and nothing else, whatever happened before; it mixes nothing."""

from __future__ import annotations

import contextlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import waiting
import xarray
import yaml
from conventions import breaches
from filelock import FileLock
from run_files import contents
from waiting import PATIENCE, children, ended, go_on, halted

from dafw.commands import main
from dafw.studies import many_runs

SMALL = ["experiment=linear_advection", "members=5", "cycles=5", "model.cells=20", "model.length=20"]
MINE = {"title": "mine", "overrides": SMALL, "axes": {"filter": ["etkf", "enkf"]}, "seeds": "1-2", "success": 80}
HALTS = ["policy=halting", "policy.folder=halt"]
HALTING = {
    "overrides": [*SMALL, "filter=etkf"],
    "configurations": {"plain": [], "halts": HALTS},
    "axes": {},
    "seeds": "0-1",
}
BUILT_IN = ["ablation", "filters", "forecast", "leak", "literal", "mismatch", "recommended", "tiny"]
WORDS = ["study", "mine", "--config-dir", "my", "--folder", "done", "--workers", "1", "--no-pictures"]


def write(**entries):
    """Write the study file, with other entries if need be."""
    Path("my", "study").mkdir(parents=True, exist_ok=True)
    Path("my", "study", "mine.yaml").write_text(yaml.safe_dump(MINE | entries, sort_keys=False))


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Return a folder in which the study was done, with what it printed."""
    place = tmp_path_factory.mktemp("finished")
    with contextlib.chdir(place), contextlib.redirect_stdout(io.StringIO()) as printed:
        write()
        assert main(WORDS) == 0
    return place, printed.getvalue()


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write()


@pytest.fixture
def done(finished, here):
    """Put a copy of the study that was done into the folder of the test."""
    shutil.copytree(finished[0] / "done", "done")


def ages(folder="done"):
    """Return when each run was last written."""
    return {str(file.parent): file.stat().st_mtime_ns for file in Path(folder).glob("runs/*/*/run.nc")}


def separately(*path):
    """Run the study in a process of its own, which finds the plugins in the folders of ``path``."""
    surroundings = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, path))}
    words = [sys.executable, "-m", "dafw", *WORDS]
    return subprocess.run(words, env=surroundings, capture_output=True, text=True, timeout=PATIENCE)


def refused(words, capsys):
    """Return the line with which a command is refused."""
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_a_study_leaves_ordinary_runs_and_their_statistics(finished, monkeypatch):
    place, printed = finished
    monkeypatch.chdir(place)
    lines = printed.splitlines()
    assert lines[-1] == str(place / "done") and lines[0].startswith("| configuration ")
    assert sorted(ages()) == [f"done/runs/filter={name}/seed={seed}" for name in ("enkf", "etkf") for seed in (1, 2)]
    alone = [*SMALL, "filter=enkf", "seed=2", "pictures=false", "record.fields=ends", "hydra.run.dir=one"]
    assert main(["run", *alone]) == 0
    assert contents(Path("one")) == contents(Path("done/runs/filter=enkf/seed=2"))
    summary = json.loads(Path("done/summary.json").read_text())
    assert [one["n_seeds"] for one in summary["configurations"]] == [2, 2] and summary["status"] == "complete"
    finals = [
        [json.loads(Path(f"done/runs/filter={name}/seed={n}/summary.json").read_text())["err_final"] for n in (1, 2)]
        for name in ("etkf", "enkf")
    ]
    assert [one["median_err"] for one in summary["configurations"]] == pytest.approx(np.mean(finals, axis=1))
    assert breaches("done/study.nc") == []
    with xarray.open_dataset("done/study.nc") as results:
        np.testing.assert_array_equal(results["err_final"], finals)


def test_runs_that_read_other_files_are_not_mixed(capsys):
    recorded = ["truth=null", "free=null", "readings=recorded", "readings.file=seen.csv", "readings.sd=0.5"]
    write(overrides=[*SMALL, "filter=etkf", *recorded, "readings.entries={a: 3}"], axes={}, configurations={"one": []})
    seen = Path("seen.csv")
    seen.write_text("time,value,sensor\n1,1.0,a\n3,2.0,a\n")
    assert main([*WORDS, "--seeds", "1"]) == 0
    capsys.readouterr()
    seen.write_text("time,value,sensor\n1,1.0,a\n3,2.0,a\n4,2.0,a\n")
    line = refused([*WORDS, "--seeds", "1-2"], capsys)
    assert (
        "seed=1: its run is complete, but files that it read are other ones now: seen.csv has changed; to run" in line
    )
    assert not Path("done/runs/one/seed=2").exists()


def test_what_is_there_is_not_run_again(done, capsys):
    before, results = ages(), Path("done/summary.json").read_bytes()
    assert main(WORDS) == 0 and ages() == before
    assert Path("done/summary.json").read_bytes() == results
    # One seed and one configuration more, and not all of them: the results are of what was asked for alone.
    write(axes={"filter": ["etkf", "enkf", "none"]})
    assert main([*WORDS, "--seeds", "2-3", "--configurations", "*=e[tx]kf", "*=none"]) == 0
    new = {f"done/runs/filter={one}" for one in ("etkf/seed=3", "none/seed=2", "none/seed=3")}
    assert set(ages()) - set(before) == new and before.items() <= ages().items()
    summary = json.loads(Path("done/summary.json").read_text())
    assert [one["name"] for one in summary["configurations"]] == ["filter=etkf", "filter=none"]
    assert summary["seeds"] == [2, 3]
    capsys.readouterr()
    assert main([*WORDS, "--seeds", "1-3", "--list"]) == 0
    assert [line.split("  ")[1] for line in capsys.readouterr().out.splitlines()] == [
        f"{done} of 3 runs" for done in (3, 2, 2)
    ]
    assert main([*WORDS, "--seeds", "1-3", "--report"]) == 0
    summary = json.loads(Path("done/summary.json").read_text())
    assert [one["n_missing"] for one in summary["configurations"]] == [0, 1, 1] and summary["status"] == "interrupted"


def test_runs_of_another_configuration_are_never_mixed_in(done, capsys):
    before, place = ages(), Path("done").resolve()
    changed = "its runs of 'filter=etkf' had filter.inflation = 1.0, now it is 1.1"
    line = refused([*WORDS, "filter.inflation=1.1"], capsys)
    assert line == f"dafw: {place}: {changed}; choose another --folder, or remove this one"
    write(axes={"filter": ["etkf"]})
    assert "holds runs of 'filter=enkf', which the study no longer has" in refused(WORDS, capsys)
    write()
    Path("other").mkdir()
    Path("other", "thesis.tex").touch()
    assert "other: is not empty and not the folder of a study" in refused([*WORDS, "--folder", "other"], capsys)
    with FileLock("done/.lock"):
        assert "done: another process is working on this study" in refused([*WORDS, "--seeds", "1-9"], capsys)
    assert ages() == before


def test_a_study_that_was_killed_goes_on_where_it_was(tmp_path):
    write(**HALTING)
    with halted(["-m", "dafw", *WORDS], tmp_path) as process:
        workers = children(process.pid)
        process.send_signal(signal.SIGKILL)
        process.wait(PATIENCE)
        assert ended(workers)
    before = ages()
    assert set(before) == {"done/runs/plain/seed=0", "done/runs/halts/seed=0"}
    assert json.loads(Path("done/runs/halts/seed=0/summary.json").read_text())["status"] == "interrupted"
    go_on(tmp_path)
    said = separately(tmp_path / "packages", Path(waiting.__file__).parent)
    assert (said.returncode, said.stderr) == (0, "")  # silent without a terminal
    after = ages()
    assert len(after) == 4 and after["done/runs/plain/seed=0"] == before["done/runs/plain/seed=0"]
    assert after["done/runs/halts/seed=0"] > before["done/runs/halts/seed=0"]
    for seed in (0, 1):  # the policy that halted decides the same
        never_killed = contents(Path(f"done/runs/plain/seed={seed}"))
        assert contents(Path(f"done/runs/halts/seed={seed}")) == never_killed


def test_an_interrupted_study_says_how_far_it_came(done, monkeypatch, capsys):
    def interrupted(tasks, workers):
        assert [(task.seed, task.folder.parent.name) for task in tasks] == [(3, "filter=etkf"), (3, "filter=enkf")]
        signal.raise_signal(signal.SIGTERM)
        yield

    monkeypatch.setattr(many_runs, "run_side_by_side", interrupted)
    assert main([*WORDS, "--seeds", "1-3"]) == 130
    kept = f"4 of 6 runs are kept in {Path('done').resolve()}; the same command does the others"
    assert capsys.readouterr().err == f"dafw: interrupted: {kept}\n"


def test_a_run_that_failed_is_tried_again_when_asked_for(done, capsys):
    file = Path("done/runs/filter=etkf/seed=1/summary.json")
    complete = json.loads(file.read_text())
    file.write_text(json.dumps(complete | {"status": "failed", "error": "a leg was broken"}))
    before, bits = ages(), contents(file.parent)
    assert main(WORDS) == 1 and ages() == before
    assert capsys.readouterr().err == "dafw: filter=etkf, seed 1 failed: a leg was broken\n"
    assert main([*WORDS, "--retry"]) == 0
    assert {folder for folder, age in ages().items() if before[folder] != age} == {str(file.parent)}
    assert contents(file.parent) == bits
    assert json.loads(file.read_text())["status"] == "complete"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["study"], "expected the name of a study"),
        (["study", "nothing"], f"there is no study 'nothing' (there are: {', '.join(BUILT_IN)})"),
        ([*WORDS, "--seeds", "9-3"], "--seeds: expected numbers and ranges such as 3,5,100-199, got '9-3'"),
        ([*WORDS, "--configurations", "lstm"], "has no configuration 'lstm' (it has: filter=etkf; filter=enkf)"),
        ([*WORDS, "--workers", "0"], "--workers must be at least 1, got 0"),
        ([*WORDS, "--config-dir", "nowhere"], "--config-dir nowhere: there is no such folder"),
        ([*WORDS, "--fast"], "study: unrecognized arguments: --fast"),
        ([*WORDS, "members=many"], "configuration 'filter=etkf': "),
        ([*WORDS, "truth.dt=0.5"], "configuration 'filter=etkf': the truth has dt = 0.5 s"),
        ([*WORDS, "filter.inflatoin=2"], "unknown option 'inflatoin', did you mean 'inflation'?"),
        ([*WORDS, "--workers", "2", "executor=processes"], "executor 'processes' starts processes of its own"),
        ([*WORDS, "--report"], "no run of this study is complete"),
    ],
)
def test_a_wrong_request_is_one_line_and_nothing_is_run(words, message, capsys):
    assert message in refused(words, capsys)
    assert ages() == {}


@pytest.mark.parametrize("source", ["-", "/dev/stdin"])
def test_runs_of_a_study_cannot_read_standard_input(source, capsys):
    write(configurations={"twin": [], "live": ["readings=live", f"readings.source={source}"]}, axes={})
    line = refused(WORDS, capsys)
    assert line.startswith("dafw: configuration 'live': readings 'live': the runs of a study have no standard input")
    assert not Path("done").exists()


def test_a_study_whose_floors_cannot_be_found_is_refused_before_its_runs(capsys):
    write(floor=True)
    line = "configuration 'filter=etkf': floor: model 'linear_advection' has no single numbers"
    assert refused(WORDS, capsys).startswith(f"dafw: {line}")
    assert ages() == {}


def test_studies_are_listed_with_their_size(capsys):
    assert main(["study", "--config-dir", "my", "--list"]) == 0
    listed = [line.split("  ", 1) for line in capsys.readouterr().out.splitlines()]
    assert [name.strip() for name, _ in listed] == sorted([*BUILT_IN, "mine"])
    assert [" ".join(rest.split()) for name, rest in listed if name.strip() == "mine"] == ["4 runs mine"]
