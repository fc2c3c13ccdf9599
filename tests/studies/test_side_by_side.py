"""Runs side by side in worker processes: one that fails, or that takes its worker with it, leaves the others alone."""

import json
import sys
from contextlib import closing
from pathlib import Path

import pytest
import waiting

from dafw.studies.side_by_side import Task, run_side_by_side, status_of_run

sys.path.insert(0, str(Path(waiting.__file__).parent / "core"))
import trouble

PARTS = ["~experiment", "model=trouble", "observer=grid", "policy=stationary", "filter=none", "members=4", "cycles=2"]


@pytest.fixture
def task(tmp_path, monkeypatch):
    """Return what makes a task of the model that goes wrong when it is told to."""
    trouble.install(tmp_path, monkeypatch)

    def make(kind, *more):
        return Task((*PARTS, f"model.kind_of={kind}", "pictures=false", *more), 7, tmp_path / "runs" / kind)

    return make


def test_every_run_leaves_word_of_how_it_ended(task, tmp_path):
    tasks = [task("breaks"), task("always_killed"), task("refused", "members=0"), task("none")]
    with closing(run_side_by_side(tasks, 1)) as running:
        ended = {one.folder.name: error for one, error in running}
    left = {one.folder.name: json.loads((one.folder / "summary.json").read_text()) for one in tasks}
    assert {kind: (one["status"], one["seed"]) for kind, one in left.items()} == {
        kind: ("complete" if kind == "none" else "failed", 7) for kind in ended
    }
    assert ended["none"] == ""
    broken = "at t = 1 s, phase 'forecast': model 'trouble' raised ValueError: a leg is broken"
    assert left["breaks"]["error"] == broken and ended["breaks"].startswith(broken)
    assert left["breaks"]["cycles"] == 1  # what it did is kept
    assert left["always_killed"]["error"] == ended["always_killed"]
    assert ended["always_killed"].startswith("the worker (process ")
    assert ended["always_killed"].endswith(") was killed by signal 9")
    assert left["refused"]["error"] == ended["refused"] == "study: option 'members' must be at least 1, got 0"
    assert all(status_of_run(one.folder) == left[one.folder.name]["status"] for one in tasks)
    assert status_of_run(tmp_path / "nowhere") == "missing"
