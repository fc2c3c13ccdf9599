"""``experiment=drone_log`` from files: a log that the model could have made, and the recorded one."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import yaml

import dafw
from dafw.commands import main
from dafw.core.geography import to_degrees
from dafw.plugins.models.puffs.model_track import PuffsTrack
from dafw.views.places import probability_within

CONF = Path(__file__).parents[1] / "conf" / "experiment" / "drone_log.yaml"
DATA = Path(__file__).parents[2] / "shared" / "data" / "drone_co2"
MISSING = pytest.mark.skipif(not DATA.is_dir(), reason=f"the recorded log is not shipped; it would be in {DATA}")
START = datetime(2022, 12, 12, 10, 12, 30)
MINUTES, RATE = 12, 300.0
PLACE = (50.0, -30.0)
"""Metres from where the drone is first seen."""
HOME = (5.934298, 53.327892)
HEAD = 'TimeStamp (UTC)," ""TriggerID"""," ""Latitude"""," ""Longitude"""," ""Altitude (Meter AGL)""",CO2 (ppm)\n'
READ = ["columns.time=TimeStamp", "columns.value=CO2", "time_format='UTC %y%m%d %H%M%S*'", "start=first"]


def track(seconds):
    """Return places (S, 3) of a drone that flies to and fro, 50 m wide, ever farther north, at 8 m."""
    phase = seconds / 50.0 % 1.0
    x = -100.0 + 120.0 * np.where(phase < 0.5, 2.0 * phase, 2.0 - 2.0 * phase)
    return np.column_stack([x, 10.0 + 80.0 * seconds / (60.0 * MINUTES), np.full(len(seconds), 8.0)])


def write(folder, gas):
    """Write a log in the recorded one's format, unsorted, with repeated times, and a wind table; return their paths."""
    seconds = np.repeat(np.arange(1.0, 60.0 * MINUTES), 1 + (np.arange(1, 60 * MINUTES) % 7 == 0))
    places, levels = track(seconds), gas(seconds)
    degrees = to_degrees(places[:, :2], HOME)
    lines = [
        f"UTC {START + timedelta(seconds=second):%y%m%d %H%M%S} 5 9 ,{1000 + n},{lat:.9f},{lon:.9f},{z:.2f},{level:.0f}"
        for n, (second, (lon, lat), (_, _, z), level) in enumerate(zip(seconds, degrees, places, levels, strict=True))
    ]
    order = np.random.default_rng(0).permutation(len(lines))
    (folder / "log.csv").write_text("\ufeff" + HEAD + "\n".join(lines[n] for n in order) + "\n", encoding="utf-8")
    rng = np.random.default_rng(1)
    rows = [
        f"{t // 60:02d}m {t % 60:02d}s,8.0 m,{rng.normal(180.0, 12.0):.0f}°,\u00a0 {rng.normal(2.0, 0.4):.2f} m/s"
        for t in range(20, 60 * MINUTES, 5)
    ]
    text = "\ufeffFlight time,Altitude,Wind Direction,Wind Speed\n" + "\n".join(rows) + "\n"
    (folder / "wind.csv").write_text(text, encoding="utf-8")
    return folder / "log.csv", folder / "wind.csv"


def words(log, wind, folder, **more):
    """Return the words of a run on such files."""
    asked = {"readings.file": log, "model.wind.file": wind, "seed": 1000, "hydra.run.dir": folder, **more}
    return ["experiment=drone_log", *(f"{key}={value}" for key, value in asked.items())]


STARTS = {"model.wind.starts": "[2022-12-12T10:12:30Z]", "readings.start": "2022-12-12T10:12:30Z"}


def filled(text, options):
    """Return the options of a group with the references to others filled in."""
    if isinstance(text, dict):
        return {key: filled(value, options) for key, value in text.items()}
    if isinstance(text, str) and text.startswith("${"):
        found = options
        for name in text[2:-1].split("."):
            found = found[name]
        return found
    return text


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Files of a leak that the model could have made, in a drifting background."""
    folder = tmp_path_factory.mktemp("made")
    log, wind = write(folder, lambda seconds: np.full(len(seconds), 440.0))
    options = yaml.safe_load(CONF.read_text())
    options["readings"] |= {"file": str(log), "start": "2022-12-12T10:12:30Z"}
    shape = {"wind_turn": 0.0, "wind_factor": 1.0, "first_width": 0.6, "first_height": 0.6, "spread": 0.3, "lift": 1.0}
    truth = {"release_x": PLACE[0], "release_y": PLACE[1], "rate": RATE, **shape, "response_time": 10.0}
    group = filled(options["model"], options)
    group["wind"] |= {"file": str(wind), "starts": ["2022-12-12T10:12:30Z"]}
    model = PuffsTrack.from_options(**group | {"dt": 1.0, "moments": 1}, truth=truth)
    members, shown = np.append([0.0, 0.0], list(truth.values()))[np.newaxis], []
    for second in range(60 * MINUTES):
        members = model.step(members, float(second), None)
        shown.append(members[0, 1])
    assert max(shown) > 60.0
    rng = np.random.default_rng(8)

    def gas(seconds):
        drift = 440.0 + 5.0 * np.sin(seconds / 200.0)
        return drift + np.array(shown)[seconds.astype(int)] + rng.normal(0.0, 4.0, len(seconds))

    return write(folder, gas)


def test_a_made_leak_is_found_in_its_log(made, tmp_path):
    """Its sensor does not swing with the way of the flight, so that means over ten seconds may be used."""
    more = {"members": 100, "model.moments": 10, "readings.averaging": 10, "cycles": 6 * MINUTES} | STARTS
    run = dafw.run(words(*made, tmp_path, **more))
    weight = run["weight"].values[-1]
    place = np.array([weight @ run[f"release_{axis}_members"].values[-1] for axis in "xy"])
    assert abs(place[0] - PLACE[0]) < 25.0  # across the wind; along it, place, rate and growth are hard to tell apart
    assert place[1] < 0.0  # upwind of all that was flown over
    assert probability_within(run, -1, np.array(PLACE)) < 0.99
    assert (Path(run.attrs["folder"]) / "figures" / "expected.png").is_file()
    again = dafw.run(words(*made, tmp_path / "again", **more | {"cycles": 12, "pictures": "false"}))
    np.testing.assert_array_equal(again["release_x_members"].values, run["release_x_members"].values[:13])


def test_the_log_is_described_and_drawn(made, tmp_path, capsys):
    picture = tmp_path / "log.png"
    few = [*READ, "origin=first", "repeated=mean", "sd=5", "background=440", "--picture", str(picture)]
    assert main(["readings", str(made[0]), *few]) == 0
    said = capsys.readouterr().out
    assert "times back" in said and "units     ppm" in said and "about 5.93" in said and str(picture) in said
    assert picture.stat().st_size > 10_000


@MISSING
def test_the_recorded_log_is_described(capsys):
    assert main(["readings", str(DATA / "day1_100m.csv"), *READ, "origin=first", "repeated=mean", "sd=10"]) == 0
    said = capsys.readouterr().out
    assert "2381 lines" in said and "readings  2101" in said and "2022-12-12T13:44:43Z" in said


@MISSING
def test_the_recorded_log_is_assimilated(tmp_path):
    files = DATA / "day1_100m.csv", DATA / "day1_100m_wind.csv"
    few = {"members": 60, "model.moments": 6, "cycles": 8, "filter.steps": 4000, "pictures": "false"}
    run = dafw.run(words(*files, tmp_path, **few))
    weight = run["weight"].values[-1]
    assert weight.sum() == pytest.approx(1.0) and np.isfinite(run["filter_background"].values[-1]).all()
    assert "truth" not in run.attrs and not [name for name in run.variables if name.startswith("truth")]
