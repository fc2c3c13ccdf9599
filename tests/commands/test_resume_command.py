"""``dafw resume`` of a multirun and of a study: only what is missing, unfinished or failed is run."""

import json
import shutil
from pathlib import Path

import pytest
import yaml

from dafw.commands import main
from dafw.core.errors import RunError
from dafw.core.sweeps import requested
from dafw.plugins.models.lorenz96 import Lorenz96
from dafw.studies import many_runs
from dafw.studies.side_by_side import run_task


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


SWEEP = ["run", "-m", "experiment=lorenz96", "members=4", "cycles=3", "pictures=false", "hydra.sweep.subdir=${seed}"]


def test_a_multirun_goes_on_from_any_folder(tmp_path, monkeypatch, capsys):
    step, wrong = Lorenz96.step, {1: 0.1, 2: 0.1}

    def fails(self, members, t, rng):
        if len(members) == 4 and wrong.get(rng._streams.seed, 9.0) <= t:
            raise ValueError("no power")
        return step(self, members, t, rng)

    monkeypatch.setattr(Lorenz96, "step", fails)
    assert main([*SWEEP, "seed=0,1,2", "hydra.sweep.dir=sweep"]) == 1
    capsys.readouterr()
    moved = Path("sweep").rename("it's moved").resolve()
    times = (moved / "0" / "run.nc").stat().st_mtime_ns
    monkeypatch.chdir("/")
    wrong.pop(2)
    assert main(["resume", str(moved)]) == 1
    captured = capsys.readouterr()
    out = captured.out.splitlines()
    assert out[0] == "3 runs: 1 complete, 2 failed"
    assert "model 'lorenz96' raised ValueError: no power" in captured.err
    (row,) = [line for line in out if line.startswith("seed=")]
    assert row.split()[:8] == ["seed=1", "failed", "2", "of", "3", "0.1", "s", "forecast"] and "no power" in row
    known = json.loads((moved / "2" / "summary.json").read_text())
    assert known["status"] == "complete" and known["resumed_after"] == [2]
    assert (moved / "0" / "run.nc").stat().st_mtime_ns == times
    assert not (tmp_path / "outputs").exists()


@pytest.fixture
def in_this_process(monkeypatch):
    """Run the runs of a study here, and not in workers that must import everything first."""

    def one_by_one(tasks, workers):
        for task in tasks:
            yield task, run_task(task).value

    monkeypatch.setattr(many_runs, "run_side_by_side", one_by_one)


def test_a_study_goes_on(in_this_process, tmp_path, monkeypatch, capsys):
    tiny = {
        "overrides": ["experiment=lorenz96", "cycles=2", "members=4"],
        "configurations": {"one": []},
        "seeds": "0-1",
    }
    Path("my/study").mkdir(parents=True)
    Path("my/study/small.yaml").write_text(yaml.safe_dump(tiny))
    words = ["study", "small", "--config-dir", "my", "--workers", "1", "--no-pictures"]
    assert main([*words, "--folder", "elsewhere", "members=5"]) == 0
    capsys.readouterr()
    shutil.rmtree("elsewhere/runs/one/seed=1")
    folder = tmp_path / "elsewhere"
    monkeypatch.chdir("/")
    assert main(["resume", str(folder)]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "2 runs: 1 complete, 1 missing" and out[-1] == str(folder)
    assert json.loads((folder / "runs/one/seed=1/summary.json").read_text())["members"] == 5
    request = json.loads((folder / "request.json").read_text())
    assert request["command"] == {"words": [*words[1:], "members=5"], "working_folder": str(tmp_path)}
    for broken, message in (
        (json.dumps({"configurations": {}}), "does not say by which command"),
        ("[]", "does not say by which command"),
        ("{", "cannot be read"),
    ):
        (folder / "request.json").write_text(broken)
        assert main(["resume", str(folder)]) == 2
        assert message in capsys.readouterr().err


@pytest.mark.parametrize("text", ["", "hydra: 3", "a: [", "hydra: {overrides: {}}"])
def test_a_request_that_cannot_be_read_is_named(text, tmp_path, capsys):
    (tmp_path / "multirun.yaml").write_text(text)
    with pytest.raises(RunError, match=r"multirun.yaml: cannot be read"):
        requested(tmp_path)
    assert main(["resume", str(tmp_path)]) == 2
    assert "cannot be read" in capsys.readouterr().err
