"""Models that are external programs: numbers are passed exactly, and every way in which a program can fail."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from waiting import ended, until

from dafw import ComputationError, ContractError, Ensemble, ProgramModel, StateSpace, Variable
from dafw.core.rng import Streams

WAYS = """
case $0 in
  same) tail -n +2 ;;
  seed) echo $DAFW_SEED 0 0 ;;
  where) ls -A | wc -l; echo 0 0 ;;
  fails) echo setting up; echo one >&2; echo two >&2; echo no such grid >&2; echo good bye >&2; exit 3 ;;
  silent) exit 4 ;;
  killed) kill -SEGV $$ ;;
  words) echo all is well ;;
  short) echo 1 2 ;;
  nan) echo 1 nan 3 ;;
  slow) echo working; sleep 600 & echo $$ $! >"$1.new"; mv "$1.new" "$1"; sleep 600; touch "$1.done" ;;
esac
"""


@dataclass
class Shell(ProgramModel):
    command = ("sh", "-c", WAYS)
    way: str = "same"
    note: str = ""
    dt: float = 1.0

    def __post_init__(self):
        self.space = StateSpace([Variable("x", 3)])

    def initial(self, n_members, rng):
        return rng.standard_normal((n_members, 3))

    def arguments(self):
        return (self.way, self.note)


def stepped(model: ProgramModel, n_members: int = 2) -> np.ndarray:
    streams = Streams(0)
    ensemble = Ensemble(model.initial(n_members, streams.members("initial", 0)), model.space, 4.0)
    return model.forecast(ensemble, None, streams.members("step", 0)).ensemble.members


def test_numbers_pass_through_to_the_last_bit():
    model = Shell()
    assert np.array_equal(stepped(model), model.initial(2, Streams(0).members("initial", 0)))


def test_every_member_has_a_seed_of_its_own_and_the_same_again():
    seeds = stepped(Shell(way="seed"), 3)[:, 0]
    assert len(set(seeds)) == 3
    assert np.array_equal(seeds, stepped(Shell(way="seed"), 3)[:, 0])


def test_it_runs_in_an_empty_folder_and_leaves_none(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert np.array_equal(stepped(Shell(way="where")), np.zeros((2, 3)))
    assert not any(tmp_path.iterdir())


def test_files_instead_of_streams():
    class Files(Shell):
        command = ("sh", "-c", 'sed "s/1/2/" <before.txt >after.txt')

        def prepare(self, folder, values, t):
            (folder / "before.txt").write_text("1 1 1")
            return ""

        def result(self, folder, output):
            return np.loadtxt(folder / "after.txt")

    assert np.array_equal(stepped(Files(), 1), [[2.0, 1.0, 1.0]])


@pytest.mark.parametrize(
    ("way", "error", "message"),
    [
        ("fails", ComputationError, "sh ended with exit status 3; its last lines: two | no such grid | good bye"),
        ("silent", ComputationError, "sh ended with exit status 4; it said nothing"),
        ("killed", ComputationError, "sh was ended by SIGSEGV; it said nothing"),
        ("words", ContractError, "sh left no numbers that can be read: could not convert string to float: 'all'"),
    ],
)
def test_a_failure_says_what_where_and_why(way, error, message):
    with pytest.raises(error) as caught:
        stepped(Shell(way=way))
    assert str(caught.value) == f"model 'Shell', member 0, t = 4 s: {message}"


@pytest.mark.parametrize(
    ("way", "message"), [("short", r"must have the shape \(3,\), got \(2,\)"), ("nan", "holds nan")]
)
def test_wrong_numbers_are_refused(way, message):
    with pytest.raises(ContractError, match=f"member 0 after a step {message}"):
        stepped(Shell(way=way))


def test_a_program_that_is_not_there():
    class Missing(Shell):
        command = ("no-such-program",)

    with pytest.raises(ComputationError, match="member 0, t = 4 s: no-such-program cannot be started: No such file"):
        stepped(Missing())


def at_work(note: Path, then: Callable[..., int]) -> Callable[..., int]:
    """Return a ``Popen.wait`` that first waits for the output of the slow program."""

    def wait(process: subprocess.Popen[bytes], timeout: float | None = None) -> int:
        until(note.exists, "the program's note")
        return then(process, timeout)

    return wait


def test_after_the_time_limit_it_is_killed_with_its_children_and_no_zombie_stays(tmp_path, monkeypatch):
    note = tmp_path / "child"
    monkeypatch.setattr("subprocess.Popen.wait", at_work(note, subprocess.Popen.wait))
    with pytest.raises(ComputationError, match=r"stopped after the time limit of 0\.5 s; its last lines: working"):
        stepped(Shell(way="slow", note=str(note), time_limit=0.5))
    parent, child = map(int, note.read_text().split())
    assert ended([child]) and not (tmp_path / "child.done").exists()
    with pytest.raises(ChildProcessError):  # no child process is left
        os.waitpid(parent, os.WNOHANG)


def test_an_interruption_kills_it_too(tmp_path, monkeypatch):
    note = tmp_path / "child"

    def interrupted(process, timeout=None):
        monkeypatch.undo()
        raise KeyboardInterrupt

    monkeypatch.setattr("subprocess.Popen.wait", at_work(note, interrupted))
    with pytest.raises(KeyboardInterrupt):
        stepped(Shell(way="slow", note=str(note)))
    assert ended([int(process) for process in note.read_text().split()])


def test_which_program_runs_is_no_option():
    from dafw.core.options import describe

    assert {option.name for option in describe(Shell)} == {"way", "note", "dt", "time_limit"}
