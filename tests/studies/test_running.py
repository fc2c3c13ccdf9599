"""Runs as users see them: files, exit status, interruption, the last line of output."""

import json
import signal
from pathlib import Path

import pytest
import yaml
from run_files import contents
from waiting import HALT, PATIENCE, go_on, halted

import dafw
from dafw.commands import main


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working folder and a quick experiment."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my" / "experiment").mkdir(parents=True)
    study = {
        "defaults": [{"override /model": "ad"}, {"override /observer": "drone"}, "_self_"],
        "name": "quick",
        "members": 4,
        "cycles": 4,
        "pictures": False,
        "model": {
            "mesh": {"wall_size": 40.0, "far_size": 60.0},
            "release": [250.0, 40.0],
            "wind_speed": 4.0,
            "wind_speed_sd": 2.0,
            "noise": 0.1,
        },
        "truth": {"wind_speed": 5.0, "wind_speed_sd": 0.0, "noise": 0.0},
        "free": {"wind_speed_sd": 0.0, "noise": 0.0},
        "vehicle": {"start": [[250.0, 0.0]]},
    }
    text = "# @package _global_\n" + yaml.safe_dump(study, sort_keys=False)
    (tmp_path / "my" / "experiment" / "quick.yaml").write_text(text)
    return tmp_path


RUN = ["run", "--config-dir", "my", "experiment=quick"]


def last_line(capsys):
    out = capsys.readouterr().out.strip().splitlines()
    return Path(out[-1]), out


def test_a_run_leaves_what_the_contract_says(folder, capsys):
    assert main([*RUN, "pictures=true", "section=[[300,0],[0,0]]"]) == 0
    path, out = last_line(capsys)
    assert path.is_absolute() and path.parent == folder / "outputs" / "quick"
    assert {"run.nc", "summary.json", "run.log", ".hydra", "figures"} <= {entry.name for entry in path.iterdir()}
    assert {"err.png", "route.png", "contours.png", "section.png"} <= {p.name for p in (path / "figures").iterdir()}
    summary = json.loads((path / "summary.json").read_text())
    assert summary["status"] == "complete" and (summary["seed"], summary["cycles"]) == (0, 4)
    assert {"err_final", "err_free_final", "wall_seconds", "phase_seconds", "versions"} <= set(summary)
    with dafw.open_run(path) as run:
        assert run.sizes["time"] == 5
        assert summary["err_final"] == pytest.approx(run["err"][-1].item())
    assert "the belief's ERR is" in out[-2] and f"{summary['err_final']:.1f} %" in out[-2]


def test_the_same_seed_gives_the_same_file_and_another_seed_another(folder, capsys):
    paths = []
    for seed in (1, 1, 2):
        assert main([*RUN, f"seed={seed}", "record.members=all"]) == 0
        paths.append(last_line(capsys)[0])
    first, again, other = map(contents, paths)
    assert "concentration_members" in first
    assert first == again
    assert first.keys() == other.keys() and first != other


def test_a_multirun_runs_every_combination(folder, capsys):
    assert main([*RUN, "-m", "policy.theta=0.0,0.3", "cycles=2"]) == 0
    sweep, _ = last_line(capsys)
    summaries = sorted(sweep.glob("*/summary.json"))
    assert [path.parent.name for path in summaries] == ["cycles=2,policy.theta=0.0", "cycles=2,policy.theta=0.3"]
    assert main(["plot", *(str(path.parent) for path in summaries), "--out", "both"]) == 0
    assert (folder / "both" / "err.png").exists()


def test_the_python_interface_gives_the_dataset(folder):
    run = dafw.run(["hydra.searchpath=[file://my]", "experiment=quick", "cycles=2"])
    assert run.sizes["time"] == 3
    assert (Path(run.attrs["folder"]) / ".hydra" / "overrides.yaml").exists()
    run.close()


def refused(words, capsys, message):
    """Check that a command ends with status 2 and a one-line message, and leaves no files."""
    assert main(words) == 2
    captured = capsys.readouterr()
    lines = captured.err.strip().splitlines()
    assert captured.out == "" and len(lines) == 1 and message in lines[0], captured
    assert not Path("outputs").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["fly"], "unknown command 'fly'"),
        (["run", "filter=etfk"], "did you mean 'etkf'"),
        (["run", "filter=etkf", "filter.inflatoin=1"], "accepted: inflation"),
        (["run", "-m", "filter=etkf,etfk"], "did you mean 'etkf'"),
        (["run", "--config-dir", "nowhere"], "no such folder"),
        (["run", "vehicle.start=[[1e6,0]]"], "vehicle 0 cannot start"),
        (["run", "model.site.file=missing.geojson"], "missing.geojson"),
        (["run", "model.mesh.wall_size=-3"], "above 0"),
        (["run", "section=[[9999,0],[9999,10]]"], "lies outside the domain"),
        (["run", "observer=stations"], "observer 'stations': option 'positions' must be given"),
        (["run", "observer=stations", "observer.positions=[]"], "at least one place"),
        (["run", "observer=stations", "observer.positions=[[1e6,0]]"], "lies outside the domain"),
        (["run", "observer=stations", "observer.positions=[[0,0]]", "observer.every=1.5"], "no multiple of the time"),
        (["run", "observer.variable=heat"], "no state variable 'heat'"),
        (["run", "policy.variable=wind_speed"], "no coordinates in the plane"),
        (["run", "filter=kalman"], "more members than the state has numbers"),
        (["run", "-m", "seed=1,1"], "the same job twice"),
        (["run", "--config-path", "my"], "--config-path would replace"),
        (["run", "--foo"], "unrecognized arguments: --foo"),
        (["run", "model.wind.solver=reduced", "model.wind.boundary=outflow"], "model 'ad_ins': wind: solver 'reduced'"),
        (["run", "model.wind.solver=reduced", "model.wind.basis.digest=abc"], "wind: the reduced basis abc"),
        (
            ["run", "-m", "model.wind.solver=reduced", "model.wind.basis.digest='',abc"],
            "model 'ad_ins': wind: the reduced basis abc is not in the cache",
        ),
        (["run", "hydra.job.chdir=true"], "hydra.job.chdir"),
        (["plugins", "etfk"], "no plugin 'etfk'"),
        (["plugins", "--what"], "unrecognized arguments: --what"),
        (["plot"], "the following arguments are required: RUN"),
        (["plot", "nowhere"], "nowhere"),
    ],
)
def test_a_wrong_request_is_one_line_and_status_2(folder, capsys, words, message):
    refused(words, capsys, message)


def test_a_computation_that_fails_keeps_what_was_done_and_says_where(folder, capsys, monkeypatch):
    from dafw.plugins.filters.etkf import ETKF

    analyse = ETKF.analyse

    def fail_late(self, forecast, predicted, observation, rng):
        if forecast.time == 3.0:
            raise ValueError("singular")
        return analyse(self, forecast, predicted, observation, rng)

    monkeypatch.setattr(ETKF, "analyse", fail_late)
    assert main(RUN) == 1
    error = capsys.readouterr().err.strip()
    assert "at t = 2 s, phase 'analyse': filter 'etkf' raised ValueError: singular; 2 of 4 cycles are kept" in error
    path = next((folder / "outputs" / "quick").iterdir())
    summary = json.loads((path / "summary.json").read_text())
    assert (summary["status"], summary["cycles"]) == ("failed", 2) and "singular" in summary["error"]
    with dafw.open_run(path) as run:
        assert run.sizes["time"] == 3


def test_a_folder_that_holds_a_run_is_left_as_it_is(folder, capsys):
    assert main([*RUN, "hydra.run.dir=here"]) == 0
    before = {path: path.read_bytes() for path in Path("here").rglob("*") if path.is_file()}
    assert main([*RUN, "hydra.run.dir=here", "seed=2"]) == 2
    assert "holds a run already" in capsys.readouterr().err
    assert before == {path: path.read_bytes() for path in Path("here").rglob("*") if path.is_file()}


def test_a_full_disk_is_a_failed_run(folder, capsys, monkeypatch):
    from dafw.core.record import Record

    append = Record.append

    def full(self, cycle):
        if cycle.state.cycle == 3:
            raise OSError(28, "No space left on device")
        return append(self, cycle)

    monkeypatch.setattr(Record, "append", full)
    assert main(RUN) == 1
    assert "No space left on device" in capsys.readouterr().err
    path = next((folder / "outputs" / "quick").iterdir())
    summary = json.loads((path / "summary.json").read_text())
    assert summary["status"] == "failed" and "No space left" in summary["error"]


def test_a_picture_that_cannot_be_drawn_does_not_spoil_the_run(folder, capsys, monkeypatch):
    def fail(run, where):
        raise dafw.RunError("no ink")

    monkeypatch.setattr("dafw.views.draw_all", fail)
    assert main([*RUN, "pictures=true"]) == 0
    captured = capsys.readouterr()
    assert "no ink" in captured.err
    assert (
        json.loads((Path(captured.out.strip().splitlines()[-1]) / "summary.json").read_text())["status"] == "complete"
    )


def halting(folder):
    """Start the quick study in another process; yield the process when it waits in cycle HALT."""
    words = ["-m", "dafw", *RUN, "policy=halting", f"policy.folder={folder / 'halt'}", "cycles=100000"]
    return halted([*words, "hydra.run.dir=run"], folder)


def test_a_killed_run_leaves_a_file_that_opens(folder):
    with halting(folder) as process:
        process.send_signal(signal.SIGKILL)
        process.wait(PATIENCE)
    with dafw.open_run("run") as run:
        assert run.sizes["time"] == HALT + 1
        assert run["err"].notnull().all()
    assert json.loads(Path("run", "summary.json").read_text())["status"] == "interrupted"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_an_interrupted_run_ends_in_order(folder, number):
    with halting(folder) as process:
        process.send_signal(number)
        go_on(folder)
        _, error = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130 and "Traceback" not in error
    assert f"interrupted: {HALT + 1} of 100000 cycles are kept in" in error
    summary = json.loads(Path("run", "summary.json").read_text())
    assert (summary["status"], summary["cycles"]) == ("interrupted", HALT + 1)
    with dafw.open_run("run") as run:
        assert run.sizes["time"] == HALT + 2
