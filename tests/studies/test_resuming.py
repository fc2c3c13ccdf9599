"""Runs that end anywhere and go on: the same file to the last bit, and a clear word where that is not possible."""

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock
from killed import killed

import dafw
from dafw import CheckpointError, ContractError, DafwError, ForecastPlan, RunError, Study
from dafw.commands import main
from dafw.core.checkpoints.checkpoint_file import FOLDER, checkpoints
from dafw.core.checkpoints.plan import CheckpointPlan
from dafw.core.composition import compose, study_part
from dafw.core.cycle import advance
from dafw.core.errors import NoMoreReadingsError
from dafw.core.executors.processes import Processes
from dafw.core.experiment import study_from
from dafw.core.runs import summary_of
from dafw.plugins.filters.enks import EnKS
from dafw.plugins.filters.esmda import ESMDA
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.filters.ienks import IEnKS
from dafw.plugins.filters.local import Local
from dafw.plugins.models.linear_advection import LinearAdvection
from dafw.plugins.models.lorenz96 import Lorenz96
from dafw.plugins.observers.grid import Grid
from dafw.plugins.policies.stationary import Stationary
from dafw.plugins.readings.recorded import Recorded
from dafw.plugins.readings.twin import Twin
from dafw.studies.from_python import keep_configuration
from dafw.studies.replaying import difference_of
from dafw.studies.resuming import LOCK, is_complete, shared
from dafw.studies.running import run_study
from dafw.studies.stopping import Interrupted
from dafw.studies.summary import Summary

EACH = CheckpointPlan(cycles=1)


def lorenz96(filter_, **more):
    parts = {"truth": Lorenz96(), "free": Lorenz96(), "observer": Grid(), "members": 6, "cycles": 9, "seed": 1003}
    return Study(model=Lorenz96(), filter=filter_, **{**parts, "checkpoint": EACH, **more})


def advection(filter_, **more):
    drifting = {"cells": 20, "error_sd": 0.01, "error_correlation": 0.5}
    parts = {"truth": LinearAdvection(**drifting), "observer": Grid(stride=5, noise_sd=0.3), "members": 5, "cycles": 8}
    return Study(model=LinearAdvection(**drifting), filter=filter_, **{**parts, "checkpoint": EACH, **more})


FORECASTS = ForecastPlan(every=0.1, horizon=0.1, lead_times=[0.0, 0.05])
STUDIES = {
    "smoother with a window, forecasts": lorenz96(EnKS(window=3), forecast=FORECASTS),
    "smoother of all cycles": lorenz96(EnKS(window=None), checkpoint=CheckpointPlan(cycles=2)),
    "fields of the ends only": lorenz96(EnKS(window=3), record_fields="ends", record="all"),
    "iterated, with a window": lorenz96(IEnKS(window=3)),
    "runs the model again, which has a memory": advection(ESMDA(window=3)),
    "a filter with a memory": advection(Local.from_options(base={"name": "enkf"})),
    "sensors that lag": lorenz96(ETKF(), readings=Twin(lag=0.1)),
}


def test_what_every_study_has(tmp_path):
    """A run that is not interrupted leaves no checkpoint."""
    run_study(lorenz96(ETKF()), tmp_path / "run")
    assert not (tmp_path / "run" / FOLDER).exists()
    assert summary_of(tmp_path / "run")["resumed_after"] == []


@pytest.mark.parametrize("name", STUDIES)
def test_a_run_that_is_killed_twice_ends_with_the_same_bits(name, tmp_path, monkeypatch):
    study, one, other = STUDIES[name], tmp_path / "whole", tmp_path / "killed"
    run_study(study, one)
    first, second = np.random.default_rng(len(name)).integers(2, 4, size=2)
    killed(monkeypatch, lambda: run_study(study, other), first + 2)
    assert (other / FOLDER).is_dir() and summary_of(other)["status"] == "interrupted"
    killed(monkeypatch, lambda: run_study(study, other, resume=True), second)
    summary = run_study(study, other, resume=True)
    step = study.checkpoint.cycles
    after = [int(first + 1) // step * step]
    after.append((after[0] + int(second - 1)) // step * step)
    assert summary["status"] == "complete" and summary["resumed_after"] == sorted(set(after))
    require_same(one, other)
    assert not (other / FOLDER).exists()
    known = summary_of(one)
    for entry in ("readings", "err_final", "innovation_rms", "parameters_final", "diverged_at", "cycles", "pinned"):
        assert known[entry] == summary[entry]
    assert (known["forecasts"] or {}).get("issued") == (summary["forecasts"] or {}).get("issued")


def require_same(one, other):
    with dafw.open_run(one) as before, dafw.open_run(other) as now:
        assert difference_of(before, now, "time") == ""
        assert list(before.variables) == list(now.variables)
    if (one / "forecast.nc").exists():
        with dafw.open_forecasts(one) as before, dafw.open_forecasts(other) as now:
            assert difference_of(before, now, "issue") == ""


@pytest.fixture
def unfinished(tmp_path, monkeypatch):
    """The folder of a run that was killed in its sixth cycle, and its study."""
    study, folder = lorenz96(ETKF()), tmp_path / "run"
    killed(monkeypatch, lambda: run_study(study, folder), 6)
    return study, folder


def test_a_run_can_go_on_without_further_checkpoints(tmp_path, monkeypatch):
    study, folder = lorenz96(EnKS(window=3), record_fields="ends"), tmp_path / "run"
    killed(monkeypatch, lambda: run_study(study, folder), 6)
    never = replace(study, checkpoint=CheckpointPlan(every=None))
    assert run_study(never, folder, resume=True)["resumed_after"] == [5]
    run_study(never, tmp_path / "whole")
    require_same(tmp_path / "whole", folder)
    assert not (folder / FOLDER).exists()


@dataclass
class Ending(Twin):
    """Has no readings from the fourth cycle on."""

    def take_with_memory(self, request, memory, rng):
        if request.cycle == 3:
            raise NoMoreReadingsError("these were all")
        return super().take_with_memory(request, memory, rng)


def interrupts(self, request, memory, rng):
    raise KeyboardInterrupt


def test_a_run_whose_readings_end_where_it_goes_on_has_the_fields_of_its_end(tmp_path, monkeypatch):
    ends = lorenz96(EnKS(window=3), record_fields="ends", record="all", readings=Ending())
    assert run_study(ends, tmp_path / "whole")["cycles"] == 3
    folder = tmp_path / "killed"
    killed(monkeypatch, lambda: run_study(ends, folder), 4)
    monkeypatch.setattr(Ending, "take_with_memory", interrupts)
    with pytest.raises(Interrupted):
        run_study(ends, folder, resume=True)
    monkeypatch.undo()
    summary = run_study(ends, folder, resume=True)
    assert (summary["status"], summary["resumed_after"]) == ("complete", [3])
    require_same(tmp_path / "whole", folder)
    with dafw.open_run(folder) as run:
        assert run["x_mean"][3].notnull().all() and run["x_forecast_mean"][3].notnull().all()


def test_what_a_checkpoint_holds_of_the_summary_does_not_grow_with_the_cycles():
    study = lorenz96(ETKF())
    cycle, summary = advance(*study.begin()), Summary(study, 0.0, 1)
    found, sizes = np.random.default_rng(0).uniform(0.5, 2.0, size=200), []
    for innovation in (*found.tolist(), np.nan):  # a cycle without readings has none
        summary.add(cycle, {"innovation_rms": innovation})
        sizes.append(len(json.dumps(summary.kept())))
    assert sizes[-1] < sizes[0] + 100
    assert summary.values()["innovation_rms"] == pytest.approx(np.sqrt(np.mean(found**2)), rel=1e-14)


def test_a_run_without_a_checkpoint_starts_again(tmp_path, monkeypatch):
    study, folder = lorenz96(ETKF(), checkpoint=CheckpointPlan()), tmp_path / "run"
    killed(monkeypatch, lambda: run_study(study, folder), 4)
    assert run_study(study, folder, resume=True)["resumed_after"] == []
    run_study(study, tmp_path / "whole")
    require_same(tmp_path / "whole", folder)


def test_a_run_that_was_killed_before_its_first_word_starts(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "summary.json").touch()
    assert run_study(lorenz96(ETKF()), tmp_path / "run", resume=True)["status"] == "complete"


def test_a_damaged_file_of_the_run_does_not_matter(unfinished):
    study, folder = unfinished
    (folder / "run.nc").write_bytes(b"\x89HDF" + bytes(range(256)) * 40)
    (folder / ".run.nc.part").write_bytes(b"left behind")
    assert run_study(study, folder, resume=True)["resumed_after"] == [5]
    run_study(study, folder.with_name("whole"))
    require_same(folder.with_name("whole"), folder)


def test_of_a_damaged_checkpoint_the_one_before_is_taken(unfinished, caplog):
    study, folder = unfinished
    newest, older = checkpoints(folder / FOLDER)
    newest.write_bytes(newest.read_bytes()[:-100])
    assert run_study(study, folder, resume=True)["resumed_after"] == [4]
    assert f"{newest}: is damaged" in caplog.text and "from the one before" in caplog.text
    run_study(study, folder.with_name("whole"))
    require_same(folder.with_name("whole"), folder)
    assert older.name == "state-000000004.npz"


def test_if_all_checkpoints_are_damaged_it_says_what_to_do(unfinished):
    study, folder = unfinished
    before = (folder / "run.nc").read_bytes()
    (folder / FOLDER / "rows.journal").write_bytes(b"nonsense")
    with pytest.raises(CheckpointError, match=r"rows.journal: is damaged .*: remove .*checkpoint to run it from the"):
        run_study(study, folder, resume=True)
    assert (folder / "run.nc").read_bytes() == before
    shutil.rmtree(folder / FOLDER)
    assert run_study(study, folder, resume=True)["resumed_after"] == []


def edited(folder, monkeypatch, **told):
    """Change what the checkpoints of a run say."""
    from dafw.core.checkpoints.checkpoint_file import read_checkpoint, write_checkpoint

    for path in checkpoints(folder / FOLDER):
        found = read_checkpoint(path)
        write_checkpoint(folder / FOLDER, replace(found, told={**found.told, **told}))


def test_another_configuration_is_refused_and_named(unfinished):
    study, folder = unfinished
    other = replace(study, filter=ETKF(inflation=1.5))
    with pytest.raises(RunError, match="another configuration"):
        run_study(other, folder, resume=True)
    (folder / "summary.json").write_text("{}")
    with pytest.raises(RunError, match=r"its run had filter.inflation = 1.0, now it is 1.5; .* another folder"):
        run_study(other, folder, resume=True)
    assert run_study(replace(study, checkpoint=CheckpointPlan(), pictures=False), folder, resume=True)


def test_with_another_executor_and_other_places_of_advice_a_run_goes_on_to_the_same_bits(unfinished, tmp_path):
    study, folder = unfinished
    run_study(study, tmp_path / "whole")
    other = replace(study, executor=Processes(workers=1), advice=[str(tmp_path / "advice.jsonl")])
    assert run_study(other, folder, resume=True)["status"] == "complete"
    with dafw.open_run(tmp_path / "whole") as before, dafw.open_run(folder) as now:
        assert json.loads(now.attrs["parts"])["executor"] == "processes"
        assert difference_of(before.assign_attrs(parts=""), now.assign_attrs(parts=""), "time") == ""


def test_other_versions_are_refused_and_named(unfinished, monkeypatch):
    study, folder = unfinished
    edited(folder, monkeypatch, versions={**summary_of(folder)["versions"], "dafw": "0.0.1"})
    with pytest.raises(RunError, match=r"same bits with other versions: dafw was 0.0.1 and is .*; install the former"):
        run_study(study, folder, resume=True)


def test_a_run_goes_on_only_with_the_files_that_it_has_read(tmp_path, monkeypatch):
    file, folder = tmp_path / "readings.csv", tmp_path / "run"
    file.write_text("time,value,entry\n0.05,1.0,3\n0.3,2.0,4\n")
    readings = Recorded.from_options(file=str(file), sd=1.0, entries={"": 3})
    study = replace(lorenz96(ETKF(), readings=readings), truth=None, free=None)
    killed(monkeypatch, lambda: run_study(study, folder), 6)
    assert list(summary_of(folder)["files"]) == [str(file)]
    before = file.read_bytes()
    for change, words in (
        (lambda: file.write_bytes(before + b"0.4,1.0,3\n"), "readings.csv has changed"),
        (lambda: file.unlink(), "not found"),
    ):
        change()
        with pytest.raises(DafwError, match=words):
            run_study(study, folder, resume=True)
        assert len(checkpoints(folder / FOLDER)) == 2, "nothing is lost"
    file.write_bytes(before)
    assert run_study(study, folder, resume=True)["status"] == "complete"
    assert is_complete(folder, study)
    file.write_bytes(before + b"0.4,1.0,3\n")
    with pytest.raises(
        RunError, match=r"is complete, but files that it read are other ones now: .*readings.csv has ch"
    ):
        is_complete(folder, study)
    file.unlink()  # of a run that is complete the files need not be there any more
    assert is_complete(folder, study)


@dataclass
class Listing(Lorenz96):
    """A model that says wrongly which files it reads."""

    files: object = ()

    @property
    def input_files(self):
        return self.files


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ("wind.csv", "input_files must be a sequence of pathlib.Path, got 'wind.csv'"),
        (["wind.csv"], r"input_files must be a sequence of pathlib.Path, got \['wind.csv'\]"),
        (None, "input_files must be a sequence of pathlib.Path, got None"),
        ([Path("nowhere.csv")], "input_files names nowhere.csv, which is no file"),
        ([Path()], r"input_files names \., which is no file"),
    ],
)
def test_files_that_are_none_are_refused_before_anything_is_written(files, message, tmp_path):
    study = replace(lorenz96(ETKF()), model=Listing(files=files))
    with pytest.raises(ContractError, match=f"model 'Listing': {message}"):
        run_study(study, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_another_start_is_refused(unfinished, monkeypatch):
    study, folder = unfinished
    from dafw.core.checkpoints.checkpoint_file import read_checkpoint

    belief, truth, free = read_checkpoint(checkpoints(folder / FOLDER)[0]).told["start"].split()
    edited(folder, monkeypatch, start=f"{belief} 00000000 {free}")
    with pytest.raises(RunError, match="the truth at the start differs from that with which the run began"):
        run_study(study, folder, resume=True)
    assert truth != "00000000"


@pytest.mark.parametrize("entry", ["state", "summary"])
def test_a_checkpoint_with_nonsense_in_it_is_refused(entry, unfinished, monkeypatch):
    study, folder = unfinished
    edited(folder, monkeypatch, **{entry: {"value": "os.system"}})
    with pytest.raises(CheckpointError, match=f"{FOLDER}: its {entry} cannot be read"):
        run_study(study, folder, resume=True)


def test_a_run_that_is_being_written_is_left_alone(unfinished):
    study, folder = unfinished
    with (
        FileLock(folder / LOCK, timeout=0),
        pytest.raises(RunError, match="another process is writing this run; nothing was changed"),
    ):
        run_study(study, folder, resume=True)
    with pytest.raises(RunError, match=f"holds a run already; nothing was changed; dafw resume {folder} goes on"):
        run_study(study, folder)


def test_a_run_of_unknown_origin_is_refused(unfinished):
    study, folder = unfinished
    shutil.rmtree(folder / FOLDER)
    (folder / "summary.json").write_text("[]")
    with pytest.raises(RunError, match="has no checkpoint, and it is not known what it computed"):
        run_study(study, folder, resume=True)


def test_a_run_that_is_stopped_or_fails_leaves_a_checkpoint_of_its_last_cycle(tmp_path, monkeypatch):
    study, folder = lorenz96(ETKF(), checkpoint=CheckpointPlan()), tmp_path / "run"
    step, calls = Lorenz96.step, []

    def fails(self, *arguments):
        calls.append(1)
        if len(calls) == 10:  # in each cycle the belief, the truth and the free run are stepped
            raise OSError("no space for a while")
        return step(self, *arguments)

    monkeypatch.setattr(Lorenz96, "step", fails)
    with pytest.raises(dafw.ComputationError, match=r"at t = 0.15 s, phase 'forecast': .* no space for a while"):
        run_study(study, folder)
    told = summary_of(folder)
    assert told["failed_at"] == {"time": pytest.approx(0.15), "phase": "forecast"} and told["status"] == "failed"
    stationary = Stationary.decide

    def stops(self, belief, *others):
        if belief.time > 0.2:
            raise KeyboardInterrupt
        return stationary(self, belief, *others)

    monkeypatch.setattr(Stationary, "decide", stops)
    with pytest.raises(Interrupted):
        run_study(study, folder, resume=True)
    monkeypatch.undo()
    assert run_study(study, folder, resume=True)["resumed_after"] == [3, 5]
    run_study(study, tmp_path / "whole")
    require_same(tmp_path / "whole", folder)


@dataclass
class Secretive(Stationary):
    """Remembers what no file can hold."""

    def decide_with_memory(self, belief, vehicle, memory, rng):
        return replace(super().decide(belief, vehicle, rng), memory={"hidden": len})


def test_memory_that_cannot_be_written_is_a_warning_and_the_run_goes_on(tmp_path, capsys):
    summary = run_study(lorenz96(ETKF(), policy=Secretive()), tmp_path / "run")
    assert summary["status"] == "complete"
    (line,) = capsys.readouterr().err.splitlines()
    assert "no checkpoint can be written" in line and "state.policy_memory['hidden']" in line


class Rank:
    """One of two ranks; what rank 0 sends is kept for the other."""

    def __init__(self, rank, sent):
        self.rank, self.sent = rank, sent

    def bcast(self, value, root):
        if self.rank == root:
            self.sent.append(value)
        return self.sent[-1]


def test_of_several_ranks_none_waits_for_a_run_that_somebody_else_completed(tmp_path):
    study = lorenz96(ETKF())
    run_study(study, tmp_path)
    with pytest.raises(RunError, match="another process has completed this run meanwhile"):
        run_study(study, tmp_path, Rank(0, []), resume=True)


def test_other_ranks_are_given_the_checkpoint(unfinished):
    from dafw.core.checkpoints.checkpoint_file import read_checkpoint

    found, sent = read_checkpoint(checkpoints(unfinished[1] / FOLDER)[0]), []
    assert shared(found, None) is found
    assert shared(found, Rank(0, sent)) is found
    other = shared(None, Rank(1, sent))
    assert (other.cycle, other.told["state"]) == (5, found.told["state"]) and other.arrays.keys() == found.arrays.keys()
    assert shared(None, Rank(0, sent)) is None and shared(None, Rank(1, sent)) is None


WORDS = ["experiment=lorenz96", "members=5", "cycles=6", "pictures=false", "checkpoint.cycles=1"]


@pytest.fixture(scope="module")
def composed():
    return study_part(compose(WORDS))


@pytest.fixture
def run_folder(tmp_path, monkeypatch, composed):
    """The folder of a run that ``dafw run`` began and that was killed."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "run"
    keep_configuration(folder / ".hydra", composed, WORDS)
    killed(monkeypatch, lambda: run_study(study_from(composed), folder), 4)
    return folder


def test_the_command_goes_on_and_says_what_is_complete(run_folder, composed, capsys):
    assert main(["resume", "run"]) == 0
    first = capsys.readouterr().out.splitlines()
    assert first[0].startswith("lorenz96, seed 0: after 6 cycles") and first[-1] == str(run_folder)
    run_study(study_from(composed), run_folder.with_name("whole"))
    require_same(run_folder.with_name("whole"), run_folder)
    before = (run_folder / "run.nc").read_bytes()
    assert main(["resume", "run"]) == 0
    assert capsys.readouterr().out.splitlines() == ["lorenz96, seed 0: complete already, 6 cycles", str(run_folder)]
    assert (run_folder / "run.nc").read_bytes() == before


def refused(words, capsys):
    assert main(words) == 2
    captured = capsys.readouterr()
    (line,) = captured.err.strip().splitlines()
    assert captured.out == ""
    return line


def test_a_complete_run_of_an_older_version_is_known_by_its_file(run_folder, composed):
    run_study(study_from(composed), run_folder, resume=True)
    known = summary_of(run_folder)
    del known["configuration"]
    (run_folder / "summary.json").write_text(json.dumps(known))
    assert is_complete(run_folder, study_from(composed))
    with pytest.raises(RunError, match="its run had members = 5, now it is 7"):
        is_complete(run_folder, study_from({**composed, "members": 7}))


def test_wrong_requests_are_one_line(run_folder, capsys):
    assert refused(["resume", "nowhere"], capsys) == "dafw: nowhere: there is no such folder"
    Path("empty").mkdir()
    assert "holds no run, multirun or study (expected .hydra/config.yaml in it)" in refused(["resume", "empty"], capsys)
    assert "arguments are required" in refused(["resume"], capsys)
    file = run_folder / ".hydra" / "config.yaml"
    text = file.read_text()
    for nonsense, message in (
        (text.replace("members: 5", "members: many"), "'members'"),
        (text.replace("members: 5", "members: 7"), "its run had members = 5, now it is 7"),
        ("model: {_target_: os.system}", "a configuration may not name code to be run"),
        ("[1, 2]", "cannot be read (it is no mapping)"),
        ("a: [", "cannot be read"),
        ("a: ${nothing}", "nothing"),
        ("\0", "cannot be read"),
    ):
        file.write_text(nonsense)
        assert message in refused(["resume", "run"], capsys)
    file.unlink()
    assert "was made of Python objects" in refused(["resume", "run"], capsys)


def test_the_same_command_goes_on_with_resume_auto(run_folder, capsys):
    command = ["run", *WORDS, "hydra.run.dir=run", "resume=auto"]
    assert "this one has the time in its name: hydra.run.dir=FOLDER" in refused(["run", *WORDS, "resume=auto"], capsys)
    assert "resume" in refused(["run", *WORDS, "resume=perhaps"], capsys)
    line = refused([*command[:-1], "resume=auto", "filter.inflation=1.02"], capsys)
    assert "its run had filter.inflation = 1.013, now it is 1.02" in line
    assert main(command) == 0
    assert summary_of(run_folder)["resumed_after"] == [3]
    capsys.readouterr()
    assert main(command) == 0
    assert capsys.readouterr().out.startswith("lorenz96, seed 0: complete already")
    assert main([*command, "executor=processes", "advice=[other.jsonl]"]) == 0
    assert capsys.readouterr().out.startswith("lorenz96, seed 0: complete already")


def test_python_goes_on(run_folder, tmp_path):
    with dafw.run(WORDS, run_folder, resume=True) as run:
        assert run.sizes["time"] == 7 and json.loads(run.attrs["versions"])
    study = lorenz96(ETKF())
    with pytest.raises(dafw.ConfigurationError, match="resume=True needs the folder"):
        dafw.run(study, resume=True)
    with dafw.run(study, tmp_path / "new", resume=True) as run:
        assert run.sizes["time"] == 10
