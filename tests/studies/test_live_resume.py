"""Live runs that were killed and go on from their journal; ``benchmarks/live_kills.py`` does it with SIGKILL."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from killed import killed, log_of_kills
from live_feeds import CYCLES, lines, waves
from run_files import contents

from dafw import Observation, Readings, Selection, Study
from dafw.commands import main
from dafw.core.errors import ReadingsError, RunError
from dafw.core.runs import summary_of
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.models.lorenz96 import Lorenz96
from dafw.plugins.readings.feed.journal import cycles_in
from dafw.plugins.readings.live import Live
from dafw.studies.running import run_study

ROOT = Path(__file__).parents[2]


@pytest.fixture
def whole(tmp_path):
    """A run that was never killed."""
    (tmp_path / "whole.jsonl").write_text(lines())
    run_study(waves(tmp_path / "whole.jsonl"), tmp_path / "whole")
    return tmp_path / "whole"


def advised(folder):
    return [json.loads(line).get("cycle") for line in (folder / "advice.jsonl").read_text().splitlines()]


def test_real_kills_of_real_processes():
    head, rows = log_of_kills("benchmarks.live_kills", 20)
    assert "journal" in head
    # By a clock, the wall's or that of the kill, a run on a busy machine may be complete before its moment has come.
    assert all("SIGKILL" in row for row in rows if "by the clock" not in row and "file, wall" not in row)


@pytest.mark.parametrize("cycle", [1, 3, 8])
def test_a_run_goes_on_with_what_came_while_it_was_down(cycle, whole, tmp_path, monkeypatch, capsys):
    feed, folder = tmp_path / "feed.jsonl", tmp_path / "run"
    feed.write_text(lines(0, cycle, end=False))
    killed(monkeypatch, lambda: run_study(waves(feed), folder), cycle)
    assert cycles_in(folder / "journal.jsonl") == cycle - 1
    with feed.open("a") as stream:
        stream.write(lines(cycle))
    capsys.readouterr()
    summary = run_study(waves(feed), folder, resume=True)
    assert contents(folder) == contents(whole)
    assert summary["readings_left_out"] == summary_of(whole)["readings_left_out"]
    said = capsys.readouterr().err
    assert (f"cycles in journal.jsonl: {cycle - 1}; then readings come from {feed}, from where" in said) == (cycle > 1)
    assert advised(folder) == [*range(cycle - 1), None, *range(cycle - 1, CYCLES + 1)]


def test_nobody_is_advised_again_about_the_past_and_half_a_line_is_ended(whole, tmp_path, monkeypatch):
    feed, folder = tmp_path / "feed.jsonl", tmp_path / "run"
    feed.write_text(lines())
    killed(monkeypatch, lambda: run_study(waves(feed), folder), 9)
    with (folder / "advice.jsonl").open("a") as stream:
        stream.write('{"cycle": 8, "ti')
    run_study(waves(feed), folder, resume=True)
    told = (folder / "advice.jsonl").read_text().splitlines()
    assert told[9] == '{"cycle": 8, "ti'
    assert [json.loads(line)["cycle"] for line in told[10:]] == [8, 9]


def test_a_journal_that_was_cut_short_or_removed_is_refused(tmp_path, monkeypatch):
    feed, folder = tmp_path / "feed.jsonl", tmp_path / "run"
    feed.write_text(lines())
    killed(monkeypatch, lambda: run_study(waves(feed), folder), 8)
    journal = folder / "journal.jsonl"
    journal.write_text("".join(journal.read_text().splitlines(keepends=True)[:20]))
    with pytest.raises(ReadingsError, match="has 19 entries, 84 were taken from it: it has been cut short"):
        run_study(waves(feed), folder, resume=True)
    journal.unlink()
    with pytest.raises(ReadingsError, match="is no journal, and 84 entries were taken from one"):
        run_study(waves(feed), folder, resume=True)


@pytest.mark.parametrize(("every", "after"), [(1, [8]), (3, [6]), (100, [])])
def test_a_feed_that_was_silent_for_too_long_is_not_asked_again(every, after, tmp_path, monkeypatch):
    feed, folder = tmp_path / "feed", tmp_path / "run"
    feed.write_text(lines(0, 5, end=False) + '{"time": 0.4, "entry": 3, "value": 1, "sd": 1}\n')
    study = waves(feed)
    study.readings.patience, study.checkpoint.cycles = 0.3, every
    killed(monkeypatch, lambda: run_study(study, folder), 9)
    with feed.open("a") as stream:
        stream.write(lines(6))
    summary = run_study(study, folder, resume=True)
    assert (summary["status"], summary["cycles"], summary["resumed_after"]) == ("complete", 8, after)
    assert sum(summary["readings"].values()) == 51


def test_a_pipe_says_that_what_was_sent_in_between_is_lost(tmp_path, monkeypatch, capsys):
    (tmp_path / "journal.jsonl").write_text('{"journal": 1, "zero": 7.0}\n{"cycle": 0, "end": true}\n')
    monkeypatch.setattr("dafw.plugins.readings.live.Pipe", lambda number: None)
    source = Live(clock="wall")
    source.begin(tmp_path, lambda: False)
    expected = "cycles in journal.jsonl: 1; then readings come from standard input as it is now"
    assert f"{expected}; what was sent in between is lost" in capsys.readouterr().err
    assert expected in source.notes()[1]
    assert source.zero_of_run(None) == 7.0 and source.known_cycles() == 1
    os.mkfifo(tmp_path / "pipe")
    other = Live(source=str(tmp_path / "pipe"))
    other.begin(tmp_path, lambda: False)
    assert "what was sent in between is lost" in capsys.readouterr().err


class Instrument(Readings):
    """A third party's live source, which keeps nothing, and knows when the run began."""

    is_live = True
    follows_wall = True

    def take(self, request, rng):
        operator = Selection(indices=np.array([0]), covariance=np.array([1.0]))
        return [Observation(np.array([1.0]), operator, request.end)]

    def zero_of_run(self, memory):
        return 1.7e9


def test_a_live_source_of_a_third_party_has_dates_in_its_advice_and_does_not_go_on_without_a_journal(tmp_path):
    study = Study(model=Lorenz96(), filter=ETKF(), members=4, cycles=3, readings=Instrument())
    run_study(study, tmp_path / "run")
    told = [json.loads(line) for line in (tmp_path / "run" / "advice.jsonl").read_text().splitlines()]
    assert told[1]["date"] == "2023-11-14T22:13:20.050000+00:00" and told[1]["behind"] > 0.0
    path = tmp_path / "run" / "summary.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "status": "interrupted"}))
    with pytest.raises(RunError, match="'Instrument' cannot go on, because it keeps no journal"):
        run_study(study, tmp_path / "run", resume=True)


def test_the_command_goes_on_with_a_live_run_and_replays_it_without_its_feed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("feed.jsonl").write_text(lines(0, 4, end=False))
    words = ["experiment=lorenz96", "readings=live", "readings.source=feed.jsonl", "readings.patience=60"]
    words += ["members=8", f"cycles={CYCLES}", "pictures=false", "checkpoint.cycles=2", "hydra.run.dir=run"]
    killed(monkeypatch, lambda: main(["run", *words]), 4)
    with Path("feed.jsonl").open("a") as stream:
        stream.write(lines(4))
    assert main(["resume", "run"]) == 0
    assert summary_of(Path("run"))["resumed_after"] == [2]
    Path("feed.jsonl").unlink()
    capsys.readouterr()
    assert main(["replay", "run"]) == 0
    assert capsys.readouterr().out.strip() == "identical"


@pytest.mark.parametrize("source", ["-", "/dev/stdin"])
def test_runs_of_a_multirun_do_not_share_standard_input(source, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["run", "-m", "experiment=lorenz96", "readings=live", f"readings.source={source}", "seed=0,1", "cycles=2"]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "would share one standard input" in said
    assert not any(tmp_path.iterdir())
