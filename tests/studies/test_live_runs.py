"""Live runs beside a simulation: the readings of the twin, the advice obeyed, and runs whose feed misbehaves."""

from __future__ import annotations

import json
import threading
from dataclasses import dataclass, field, replace
from datetime import datetime
from itertools import pairwise

import numpy as np
import pytest
from conventions import breaches
from run_files import contents
from small_plant import small_plant

import dafw
from dafw import Study
from dafw.commands import main
from dafw.core.errors import RunError
from dafw.plugins.filters.enks import EnKS
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.models.lorenz96 import Lorenz96
from dafw.plugins.observers.grid import Grid
from dafw.plugins.readings.feed.channels import GrowingFile
from dafw.plugins.readings.live import Live
from dafw.plugins.readings.twin import Twin
from dafw.studies.running import run_study
from dafw.studies.simulating import Advised, Simulation, line_of, obeyed
from dafw.studies.truth_file import TruthFile, scores_of

TELLS_NOTHING = {"observation_node"}
"""What a feed cannot tell: the number of the node that is read."""


@dataclass
class Kept:
    """A truth that is kept in memory: two threads must not use the library of netCDF at the same time."""

    rows: list = field(default_factory=list)

    def append(self, truth):
        self.rows.append(truth)


def waves(**more):
    parts = {"model": Lorenz96(), "truth": Lorenz96(), "free": Lorenz96(), "observer": Grid(stride=4)}
    return Study(**(parts | {"filter": ETKF(), "members": 12, "cycles": 8, "seed": 1000} | more))


def plant(dt=1.0, **more):
    """Return a small twin with two drones."""
    return small_plant([[0.0, -30.0], [-40.0, -30.0]], dt, **more)


def rehearsed(study, folder, truth=None, change=lambda message: [line_of(message)], cycles=None, **options):
    """Run a study live beside its simulation, both in this process, over a file; return the summary."""
    feed = folder.with_suffix(".jsonl")
    live = Live.from_options(source=str(feed), patience=30.0, **options)
    parts, vehicle = replace(study, readings=Twin()).prepare()

    def send(message):
        with feed.open("ab") as stream:
            for line in change(message):
                stream.write(line)

    advice = Advised(GrowingFile(folder / "advice.jsonl"))
    kept = Kept() if truth is None else truth
    simulation = Simulation(parts, vehicle, live, cycles or study.cycles, send, advice, kept)
    thread = threading.Thread(target=simulation.play)
    thread.start()
    try:
        return run_study(replace(study, readings=live, truth=None), folder)
    finally:
        thread.join(60.0)
        assert not thread.is_alive()


def advice_of(folder):
    return [json.loads(line) for line in (folder / "advice.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("study", [waves, plant])
def test_a_rehearsed_run_has_the_bits_of_the_twin_with_the_same_seed(study, tmp_path):
    run_study(study(), tmp_path / "twin")
    summary = rehearsed(study(), tmp_path / "live")
    assert summary["status"] == "complete" and summary["readings_left_out"] == {}
    twin, live = contents(tmp_path / "twin"), contents(tmp_path / "live")
    same = (twin.keys() & live.keys()) - TELLS_NOTHING
    assert {"observation_value", "vehicle_x", "spread", "innovation_rms"} < same
    assert [name for name in sorted(same) if twin[name] != live[name]] == []


def test_what_is_scored_afterwards_is_what_the_twin_scored(tmp_path):
    run_study(waves(), tmp_path / "twin")
    kept = Kept()
    rehearsed(waves(), tmp_path / "live", kept)
    truth = TruthFile(tmp_path / "live" / "truth.nc", waves().model.space, {"seed": 1000})
    for row in kept.rows:
        truth.append(row)
    truth.close()
    assert breaches(tmp_path / "live" / "truth.nc") == []
    found = scores_of(tmp_path / "live")
    with dafw.open_run(tmp_path / "twin") as twin:
        assert found["err"] == pytest.approx(twin["err"].values, rel=1e-5)
        assert found["err_free"] == pytest.approx(twin["err_free"].values, rel=1e-5)
        assert found["time"] == twin["time"].values.tolist()
    with pytest.raises(RunError, match="there already"):
        TruthFile(tmp_path / "live" / "truth.nc", waves().model.space, {"seed": 1000})


def test_scores_need_the_truth_of_the_same_study(tmp_path, capsys):
    run_study(waves(cycles=2), tmp_path / "run")
    assert main(["score", str(tmp_path / "run")]) == 2
    assert "dafw simulate writes it" in capsys.readouterr().err
    TruthFile(tmp_path / "run" / "truth.nc", waves().model.space, {"seed": 7}).close()
    assert main(["score", str(tmp_path / "run")]) == 2
    assert "its seed is 7, that of" in capsys.readouterr().err


def test_the_advice_says_where_to_fly_what_is_believed_and_how_sure_that_is(tmp_path):
    rehearsed(plant(), tmp_path / "live")
    told = advice_of(tmp_path / "live")
    assert [one["cycle"] for one in told] == list(range(7))
    assert told[-1]["end"] and "waypoints" not in told[-1]["vehicles"][0]
    for before, after in pairwise(told):
        for one, then in zip(before["vehicles"], after["vehicles"], strict=True):
            assert then["at"] == ([one["at"], *one["waypoints"]])[-1]
    last = told[-1]
    with dafw.open_run(tmp_path / "live") as run:
        for name, parameter in last["belief"]["parameters"].items():
            assert parameter["mean"] == run[f"{name}_mean"].values[-1]
            assert parameter["q05"] <= parameter["q50"] <= parameter["q95"] or "direction" in name
        field, spread = run["concentration_mean"].values[-1], run["concentration_spread"].values[-1]
        assert last["confidence"]["expected_error"] == pytest.approx(
            100 * np.linalg.norm(spread) / np.linalg.norm(field), rel=1e-5
        )
        x, y = run["node_x"].values[field > 0.1 * field.max()], run["node_y"].values[field > 0.1 * field.max()]
        extent = last["belief"]["gas"]["extent"]
        assert extent == pytest.approx([x.min(), y.min(), x.max(), y.max()])
    centre = last["belief"]["gas"]["centre"]
    assert extent[0] < centre[0] < extent[2] and extent[1] < centre[1] < extent[3]
    assert last["confidence"]["centre_sd"] > 0.0


def test_policies_start_from_where_the_readings_say_a_vehicle_is(tmp_path):
    def blown_away(message):
        if message.get("sensor") == "drone 0" and "value" not in message and message["time"] < 2.5:
            message = message | {"x": -60.0, "y": -45.0}
        return [line_of(message)]

    rehearsed(plant(cycles=2), tmp_path / "live", change=blown_away)
    told = advice_of(tmp_path / "live")
    assert told[0]["vehicles"][0]["at"] == [0.0, -30.0]
    assert told[1]["vehicles"][0]["at"] == told[2]["vehicles"][0]["at"] == [-60.0, -45.0]
    with dafw.open_run(tmp_path / "live") as run:
        assert run["vehicle_x"].values[1:, 0].tolist() == [-60.0, -60.0]


def test_late_readings_revise_the_belief_of_a_smoother_and_too_late_ones_are_counted(tmp_path):
    held = []

    def late(message):
        """Keep the readings of two cycles back until the fifth and the eighth."""
        if "value" in message and message["time"] in (pytest.approx(0.2), pytest.approx(0.1)):
            held.append(line_of(message))
            return []
        if message.get("until") == pytest.approx(0.25):
            out, held[:] = held[10:], held[:10]
            return [*out, line_of(message)]
        if message.get("until") == pytest.approx(0.4):
            return [*held, line_of(message)]
        return [line_of(message)]

    summary = rehearsed(waves(filter=EnKS(window=3)), tmp_path / "live", change=late)
    assert summary["readings"]["late_in_window"] == 10
    assert summary["readings"]["late_dropped"] == 10
    assert summary["readings"]["on_time"] == 60


def test_garbage_between_readings_changes_no_bit_and_is_warned_of_once_a_kind(tmp_path, capsys):
    rehearsed(waves(), tmp_path / "clean")
    capsys.readouterr()

    def noisy(message):
        bad = ["rubbish", '{"time": 0.2, "entry": 3, "value": NaN}', "y" * 70000, '{"time": 0.1, "entry": 3e9}']
        twice = [line_of(message)] * (1 + ("value" in message))
        return [*(f"{text}\n".encode() for text in bad), b"\xff\xfe\n", *twice]

    summary = rehearsed(waves(), tmp_path / "noisy", change=noisy)
    assert contents(tmp_path / "noisy") == contents(tmp_path / "clean")
    counted = summary["readings_left_out"]
    assert counted.keys() == {"unreadable", "incomplete", "too_long", "doubled"} and min(counted.values()) == 80
    warnings = [text for text in capsys.readouterr().err.splitlines() if "left out" in text]
    assert len(warnings) == len(counted)


def test_a_feed_that_ends_early_ends_the_run_complete(tmp_path):
    summary = rehearsed(waves(), tmp_path / "live", cycles=5)
    assert (summary["status"], summary["cycles"], summary["cycles_wanted"]) == ("complete", 5, 8)
    assert advice_of(tmp_path / "live")[-1]["end"]


def test_by_the_walls_clock_vehicles_fly_while_time_passes_and_readings_have_dates(tmp_path):
    study = plant(dt=0.1, cycles=3, speed=4.0)
    rehearsed(study, tmp_path / "live", clock="wall", grace=60.0)
    told = advice_of(tmp_path / "live")
    zero = json.loads((tmp_path / "live" / "journal.jsonl").read_text().splitlines()[0])["zero"]
    times = [datetime.fromisoformat(one["date"]).timestamp() - zero for one in told]
    assert times == pytest.approx([0, 0.1, 0.2, 0.3], abs=1e-5)
    assert min(one["behind"] for one in told) >= 0.0
    with dafw.open_run(tmp_path / "live") as run:
        assert run["observation_use"].max() == 0
        moved = np.hypot(*(np.diff(run[f"vehicle_{axis}"].values, axis=0) for axis in "xy"))
        assert moved.max() <= 0.4 + 1e-9


def test_a_journal_repeats_its_run(tmp_path):
    rehearsed(waves(), tmp_path / "live")
    source = Live.from_options(source=str(tmp_path / "live" / "journal.jsonl"))
    run_study(waves(readings=source, truth=None), tmp_path / "again")
    assert contents(tmp_path / "again") == contents(tmp_path / "live")


def test_a_live_study_can_be_iterated_over(tmp_path):
    lines = [json.dumps({"time": 0.05, "entry": 3, "value": 1.0, "sd": 1.0}), '{"until": 0.1}', '{"end": true}']
    (tmp_path / "feed.jsonl").write_text("\n".join(lines) + "\n")
    study = waves(readings=Live.from_options(source=str(tmp_path / "feed.jsonl")), truth=None)
    assert [cycle.observation.values.tolist() for cycle in study] == [[1.0], []]


def test_advice_reaches_files_and_a_pipe_that_nobody_reads_costs_a_warning(tmp_path, capsys):
    import os

    os.mkfifo(tmp_path / "pipe")
    study = waves(cycles=3, advice=["-", str(tmp_path / "copy.jsonl"), str(tmp_path / "pipe")])
    run_study(study, tmp_path / "run")
    written = (tmp_path / "run" / "advice.jsonl").read_text()
    said = capsys.readouterr()
    assert written == (tmp_path / "copy.jsonl").read_text() == said.out
    assert said.err.count("advice does not reach") == 1


def test_a_way_is_flown_as_far_as_time_allows():
    vehicle = dafw.Vehicle(np.array([[0.0, 0.0], [5.0, 5.0]]), speed=10.0)
    advice = {"vehicles": [{"vehicle": 0, "waypoints": [[3.0, 0.0], [3.0, 7.0]]}]}
    assert obeyed(vehicle, advice, 1.0).ends.tolist() == [[3.0, 7.0], [5.0, 5.0]]
    assert obeyed(vehicle, advice, 0.5).ends.tolist() == [[3.0, 2.0], [5.0, 5.0]]
    assert obeyed(vehicle, None, 1.0).ends.tolist() == vehicle.positions.tolist()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "give both commands the same hydra.run.dir=DIR"),
        (["experiment=lorenz96", "hydra.run.dir=a"], "plays the feed of readings=live, got readings=twin"),
        (["experiment=lorenz96", "readings=live", "readings.source=example", "hydra.run.dir=a"], "got example"),
        (["experiment=lorenz96", "readings=live", "truth=null", "hydra.run.dir=a"], "the study has none"),
    ],
)
def test_a_simulation_that_cannot_be_is_refused_in_one_line(words, said, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", *words]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "a" / "truth.nc").exists()
