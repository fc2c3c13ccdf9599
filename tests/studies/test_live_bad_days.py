"""Bad days of live runs: what fails leaves a run that goes on, to the bits of one that had a good day."""

from __future__ import annotations

import errno

import pytest
from live_feeds import lines, waves
from run_files import contents

from dafw.core.errors import RecordError, RunError, SolverError, about_member
from dafw.core.runs import summary_of
from dafw.plugins.models.lorenz96 import Lorenz96
from dafw.plugins.readings.feed import feed as feeds
from dafw.plugins.readings.feed import journal
from dafw.studies.resuming import held
from dafw.studies.running import run_study


@pytest.fixture
def feed(tmp_path):
    (tmp_path / "feed.jsonl").write_text(lines())
    return tmp_path / "feed.jsonl"


@pytest.fixture
def good(feed, tmp_path):
    """A run that had a good day."""
    run_study(waves(feed), tmp_path / "good")
    return contents(tmp_path / "good")


@pytest.mark.parametrize("number", [1, 70])
def test_a_disk_that_becomes_full_under_the_journal(number, feed, good, tmp_path, monkeypatch):
    note, calls = journal.Journal.note, []

    def full(self, cycle, line, at, offset):
        calls.append(line)
        if len(calls) == number:
            with self._writing():
                self._stream.write(b'{"cycle": 5, "at"')  # a part of the entry still had room
                self._stream.flush()
                raise OSError(errno.ENOSPC, "No space left on device")
        note(self, cycle, line, at, offset)

    monkeypatch.setattr(journal.Journal, "note", full)
    with pytest.raises(RecordError, match=r"journal.jsonl: the journal cannot be written \(No space left on device\)"):
        run_study(waves(feed), tmp_path / "run")
    assert summary_of(tmp_path / "run")["status"] == "failed"
    run_study(waves(feed), tmp_path / "run", resume=True)
    assert contents(tmp_path / "run") == good


def test_a_member_that_cannot_be_solved_is_named_and_the_run_goes_on_when_that_is_mended(
    feed, good, tmp_path, monkeypatch
):
    step = Lorenz96.step

    def fails(self, members, t, rng):
        if len(members) == 8 and t > 0.22:
            with about_member(3):
                raise SolverError("no wind solves the equations")
        return step(self, members, t, rng)

    monkeypatch.setattr(Lorenz96, "step", fails)
    with pytest.raises(SolverError, match=r"at t = 0.25 s, phase 'forecast': .*member 3.*; 5 of 9 cycles are kept"):
        run_study(waves(feed), tmp_path / "run")
    monkeypatch.setattr(Lorenz96, "step", step)
    assert run_study(waves(feed), tmp_path / "run", resume=True)["resumed_after"] == [5]
    assert contents(tmp_path / "run") == good


def test_two_runs_into_one_folder(feed, tmp_path):
    run_study(waves(feed), tmp_path / "run")
    before = {path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()}
    with pytest.raises(RunError, match="holds a run already; nothing was changed"):
        run_study(waves(feed), tmp_path / "run")
    (tmp_path / "other").mkdir()
    with held(tmp_path / "other"), pytest.raises(RunError, match="another process is writing this run"):
        run_study(waves(feed), tmp_path / "other")
    assert {path: path.read_bytes() for path in before} == before
    assert not (tmp_path / "other" / "journal.jsonl").exists()


def test_the_clock_of_the_machine_jumps_back(monkeypatch):
    now = [1000.0, 50.0]
    monkeypatch.setattr(feeds, "time", lambda: now[0])
    monkeypatch.setattr(feeds, "monotonic", lambda: now[1])
    clock = feeds.Clock()
    now[:] = [400.0, 51.5]
    assert clock() == 1001.5
