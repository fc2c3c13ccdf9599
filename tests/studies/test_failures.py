"""How a failed run ends: one line that names the plugin, the right exit status, a closed record, a correct summary."""

import errno
import json
import os
import signal
from pathlib import Path
from typing import ClassVar

import pytest

import dafw
from dafw import ComputationError, Model, RunError, StateSpace, Study, Variable
from dafw.commands import main
from dafw.core.executors.serial import Serial
from dafw.core.files import write_atomically
from dafw.core.record import Record
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.models.lorenz96 import Lorenz96
from dafw.plugins.observers.grid import Grid
from dafw.plugins.policies.stationary import Stationary
from dafw.plugins.readings.twin import Twin
from dafw.studies.running import refuse_run, run_study

RUN = ["run", "experiment=lorenz96", "cycles=3", "pictures=false", "hydra.run.dir=run"]


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def failing(name, error=ValueError, when=lambda self: True, otherwise=None):
    """Return a method of that name that raises an error if ``when`` returns true."""

    def method(self, *arguments):
        if when(self):
            raise error("broken")
        return otherwise(self, *arguments)

    method.__code__ = method.__code__.replace(co_name=name)
    return method


def ended(words, capsys):
    """Run a command that fails; return its exit status and its line on standard error."""
    status = main(words)
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    return status, lines[0]


def summary(folder="run"):
    return json.loads(Path(folder, "summary.json").read_text())


@pytest.mark.parametrize(
    ("cls", "name", "label"),
    [
        (Lorenz96, "require_available", "model 'lorenz96'"),
        (Grid, "suit", "observer 'grid'"),
        (Grid, "operator", "observer 'grid'"),
        (Stationary, "suit", "policy 'stationary'"),
        (ETKF, "suit", "filter 'etkf'"),
        (ETKF, "require_members", "filter 'etkf'"),
        (Twin, "suit", "readings 'twin'"),
    ],
)
def test_a_check_that_a_plugin_breaks_in_is_one_line_before_anything_is_made(cls, name, label, monkeypatch, capsys):
    monkeypatch.setattr(cls, name, failing(name))
    assert ended(RUN, capsys) == (1, f"dafw: {label} raised ValueError in '{name}': broken")
    assert not Path("run").exists()


class Walk(Model):
    """A random walk of one number."""

    space, dt = StateSpace([Variable("x", 1)]), 1.0

    def initial(self, n_members, rng):
        return rng.standard_normal((n_members, 1))

    def step(self, members, t, rng):
        return members + rng.standard_normal(members.shape)


def test_properties_that_fail_name_their_plugin(monkeypatch):
    for name in ("space", "domain", "dt"):
        broken = type("Broken", (Walk,), {name: property(failing(name))})
        with pytest.raises(ComputationError, match=f"^model 'Broken' raised ValueError in '{name}': broken$"):
            dafw.run(Study(model=broken(), truth=Walk(), filter=ETKF()), "run")
    assert not Path("run").exists()


def test_a_file_that_a_plugin_does_not_find_is_a_wrong_request(monkeypatch, capsys):
    monkeypatch.setattr(Grid, "suit", failing("suit", FileNotFoundError))
    assert ended(RUN, capsys) == (2, "dafw: observer 'grid' raised FileNotFoundError in 'suit': broken")


def test_a_plugin_whose_label_fails_is_still_named():
    broken = type("Broken", (Walk,), {"step": failing("step")})
    study = Study(model=broken(), truth=Walk(), filter=ETKF())
    broken.label = property(failing("label"))
    with pytest.raises(ComputationError, match="phase 'forecast': model 'Broken' raised ValueError: broken"):
        dafw.run(study, "run")
    assert summary()["status"] == "failed"
    with pytest.raises(ComputationError, match=r"^model 'Broken' raised ValueError in 'label': broken$"):
        Study(model=broken(), truth=Walk(), filter=ETKF())


@pytest.mark.parametrize(
    ("cls", "name", "label"),
    [
        (Lorenz96, "notes", "model 'lorenz96'"),
        (Lorenz96, "pinned_options", "model 'lorenz96'"),
        (Lorenz96, "initial_memory", "model 'lorenz96'"),
        (ETKF, "initial_memory", "filter 'etkf'"),
        (Stationary, "initial_memory", "policy 'stationary'"),
        (Twin, "initial_memory", "readings 'twin'"),
        (Serial, "start", "executor 'serial'"),
        (Serial, "close", "executor 'serial'"),
    ],
)
@pytest.mark.parametrize("error", [ValueError, RuntimeError, OSError, SystemExit])
def test_a_plugin_that_breaks_in_a_run_is_one_line_and_a_failed_run(cls, name, label, error, monkeypatch, capsys):
    monkeypatch.setattr(cls, name, failing(name, error))
    status, line = ended(RUN, capsys)
    assert status == 1 and label in line and f"raised {error.__name__}" in line and "broken" in line
    assert "cannot be written" not in line
    assert summary()["status"] == "failed" and label in summary()["error"]
    assert summary()["cycles"] == (3 if name == "close" else 0)
    if Path("run", "run.nc").exists():
        dafw.open_run("run").close()


def test_one_jobs_failure_is_its_own(monkeypatch, capsys):
    suit = ETKF.suit
    monkeypatch.setattr(ETKF, "suit", failing("suit", when=lambda self: self.inflation == 1.5, otherwise=suit))
    words = [
        *RUN[:-1],
        "-m",
        "filter.inflation=1.0,1.5,2.0",
        "hydra.sweep.dir=sweep",
        "hydra.sweep.subdir=${hydra.job.num}",
    ]
    assert ended(words, capsys) == (1, "dafw: filter 'etkf' raised ValueError in 'suit': broken")
    assert [summary(f"sweep/{number}")["status"] for number in (0, 2)] == ["complete"] * 2
    assert not Path("sweep", "1", "summary.json").exists()


def test_a_fault_in_one_job_lets_the_others_run(monkeypatch, capsys):
    def faulty(study, *arguments, **options):
        if study.seed == 1:
            raise KeyError("two\nlines")
        return run_study(study, *arguments, **options)

    monkeypatch.setattr("dafw.commands.run.run_study", faulty)
    words = [*RUN[:-1], "-m", "seed=0,1,2", "hydra.sweep.dir=sweep", "hydra.sweep.subdir=${seed}"]
    assert ended(words, capsys) == (1, "dafw: KeyError: 'two\\nlines'")
    assert [summary(f"sweep/{seed}")["status"] for seed in (0, 2)] == ["complete"] * 2


@pytest.mark.parametrize(
    ("number", "status"),
    [(errno.ENOSPC, 1), (errno.EDQUOT, 1), (errno.EIO, 1), (errno.EACCES, 2), (errno.ENOTDIR, 2)],
)
def test_a_disk_that_fails_is_no_wrong_request(number, status, monkeypatch, capsys):
    def fail(path):
        raise OSError(number, os.strerror(number), str(path))

    monkeypatch.setattr("dafw.studies.running.claim", fail)
    found, line = ended(RUN, capsys)
    assert (found, os.strerror(number) in line) == (status, True)


def test_a_disk_that_is_full_at_the_very_end_is_a_failed_run(monkeypatch, capsys):
    def flush(self):
        if self._rows and self._rows[-1]["time"] > 0.1:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Record, "flush", flush)
    status, line = ended(RUN, capsys)
    assert status == 1 and "the run cannot be written (OSError: [Errno 28] No space left" in line
    assert summary()["status"] == "failed" and "No space left" in summary()["error"]
    dafw.open_run("run").close()


def test_a_summary_that_cannot_be_written_is_a_failed_run_but_the_first_error_is_told(monkeypatch, capsys):
    def full(path, text):
        if json.loads(text)["cycles"]:
            raise OSError(errno.ENOSPC, "No space left on device")
        write_atomically(path, text)

    monkeypatch.setattr("dafw.studies.running.write_atomically", full)
    status, line = ended(RUN, capsys)
    assert status == 1 and "the run cannot be written (OSError: [Errno 28] No space left" in line
    monkeypatch.setattr(Serial, "close", failing("close"))
    assert ended([*RUN[:-1], "hydra.run.dir=other"], capsys)[1].startswith("dafw: executor 'serial' raised ValueError")


def test_a_failed_run_has_its_configuration(monkeypatch):
    monkeypatch.setattr(ETKF, "analyse", failing("analyse"))
    with pytest.raises(ComputationError, match="broken"):
        dafw.run([*RUN[1:-1], "filter.inflation=1.25"], "run")
    assert "inflation: 1.25" in Path("run", ".hydra", "config.yaml").read_text()
    assert "filter.inflation=1.25" in Path("run", ".hydra", "overrides.yaml").read_text()


def test_an_interrupted_run_is_a_keyboard_interrupt(monkeypatch):
    class Interrupting(Stationary):
        def decide(self, belief, vehicle, rng):
            if belief.time == 2.0:
                os.kill(os.getpid(), signal.SIGINT)
            return super().decide(belief, vehicle, rng)

    study = Study(model=Walk(), filter=ETKF(), truth=Walk(), policy=Interrupting(), cycles=100)
    with pytest.raises(KeyboardInterrupt, match="3 of 100 cycles are kept"):
        dafw.run(study, "run")
    assert (summary()["status"], summary()["cycles"]) == ("interrupted", 3)
    with dafw.open_run("run") as run:
        assert run.sizes["time"] == 4


class Rank:
    """One of two ranks; messages of rank 0 are kept for the others."""

    told: ClassVar[list[bool]] = []

    def __init__(self, rank):
        self.rank = rank

    def bcast(self, value, root):
        if self.rank == root:
            Rank.told.append(value)
        return Rank.told[-1]


def test_of_several_ranks_the_first_looks_whether_the_folder_is_free():
    refuse_run(Path("run"), Rank(0))
    Path("run").mkdir()
    Path("run", "summary.json").touch()  # rank 0 was first
    refuse_run(Path("run"), Rank(1))
    for rank in (0, 1):
        with pytest.raises(RunError, match="holds a run already"):
            refuse_run(Path("run" if rank == 0 else "another place"), Rank(rank))
