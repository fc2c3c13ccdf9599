"""Log, progress and closing line of a run, with and without a truth, a free run and readings."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

import dafw
from dafw import NONNEGATIVE, ConfigurationError, Model, RunError, StateSpace, Study, Variable
from dafw.plugins.filters.enks import EnKS
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.observers.grid import Grid
from dafw.plugins.readings.listed import Listed
from dafw.plugins.readings.twin import Twin
from dafw.studies.reporting import closing_line, said_of_readings
from dafw.studies.running import run_study

LATE = [
    {"time": 10.0, "value": 1.9},
    {"time": 14.0, "value": 1.8, "arrives": 38.0},
    {"time": -5.0, "value": 1.8},
]


def pond_space(kind=NONNEGATIVE):
    return StateSpace([Variable("level", 1, kind)])


@dataclass
class Pond(Model):
    """A level that falls."""

    space: StateSpace = field(default_factory=pond_space)
    dt: float = 10.0
    leak: float = 0.01

    def initial(self, n_members, rng):
        return 2.0 + 0.2 * rng.standard_normal((n_members, 1))

    def step(self, members, t, rng):
        return members * (1.0 - self.dt * self.leak)


def study(**changes):
    parts = {"model": Pond(), "filter": ETKF(), "readings": Listed(LATE, sd=0.1), "members": 5, "cycles": 5}
    return Study(name="pond", **(parts | changes))


def closed(folder, **changes):
    """Return the closing line of a study without its duration, and the lines of its log."""
    made = study(**changes)
    line = closing_line(made, run_study(made, folder))
    log = (folder / "run.log").read_text().splitlines()
    assert log[-1].endswith(f"INFO {line}")
    return line.rpartition(" (")[0], log


@pytest.mark.parametrize(
    ("counts", "text"),
    [
        ({}, "no readings"),
        ({"on_time": 1, "late_dropped": 0}, "1 reading"),
        ({"on_time": 800}, "800 readings"),
        (
            {"on_time": 3, "late_in_window": 2, "late_used_now": 1, "late_dropped": 4, "before_start": 1},
            "11 readings (3 on time, 3 late, 5 dropped)",
        ),
        ({"on_time": 0, "late_in_window": 2}, "2 readings (2 late)"),
    ],
)
def test_what_became_of_the_readings_is_said_in_numbers(counts, text):
    assert said_of_readings(counts) == text


def test_without_a_truth_the_readings_say_how_the_belief_did(tmp_path):
    line, log = closed(tmp_path / "pond")
    rms = line.split("mean square is ")[1].split(" ")[0]
    assert line.startswith("pond, seed 0: after 5 cycles and 3 readings (1 on time, 2 dropped) the innovations' root")
    assert line.endswith(f"root mean square is {float(rms):.2f} (of an honest belief: 1)")
    assert "not defined" not in line and "ERR" not in line
    assert any(f"t = 10 s: innovations {rms}, 2 readings (1 on time, 1 dropped)" in entry for entry in log)


def test_late_readings_that_a_window_reaches_are_late_and_not_dropped(tmp_path):
    line, _ = closed(tmp_path / "pond", filter=EnKS())
    assert "after 5 cycles and 3 readings (1 on time, 1 late, 1 dropped)" in line


def test_without_a_truth_and_without_readings_there_is_nothing_to_say(tmp_path):
    line, log = closed(tmp_path / "pond", readings=Listed())
    assert line == "pond, seed 0: after 5 cycles and no readings there is no truth to compare the belief with"
    assert any(entry.endswith("t = 50 s: no readings") for entry in log)


def test_a_free_run_without_a_truth_is_not_said_to_have_an_error(tmp_path):
    assert "free run" not in closed(tmp_path / "pond", free=Pond())[0]


def test_with_a_truth_the_belief_is_held_against_the_free_run_and_an_empty_map(tmp_path):
    twin = {"readings": Twin(), "observer": Grid()}
    line, log = closed(tmp_path / "all", truth=Pond(), free=Pond(leak=0.02), **twin)
    with dafw.open_run(tmp_path / "all") as run:
        err, free = float(run["err"][-1]), float(run["err_free"][-1])
    ending = f"the belief's ERR is {err:.1f} %, the free run's {free:.1f} %, an empty map's 100 %"
    assert line == f"pond, seed 0: after 5 cycles and 5 readings {ending}"
    assert any(f"t = 50 s: ERR {err:.2f} %, free run {free:.2f} %, 1 reading" in entry for entry in log)
    line, _ = closed(tmp_path / "alone", truth=Pond(), **twin)
    assert "free run" not in line and "an empty map's 100 %" in line


def test_an_empty_map_means_nothing_for_a_variable_that_may_be_negative(tmp_path):
    line, _ = closed(
        tmp_path / "pond", model=Pond(pond_space(dafw.FIELD)), truth=Pond(pond_space(dafw.FIELD)), readings=Listed(LATE)
    )
    assert "the belief's ERR is" in line and "empty map" not in line


def test_a_truth_that_vanishes_leaves_the_error_undefined(tmp_path):
    line, _ = closed(tmp_path / "pond", truth=Pond(leak=0.1))  # nothing is left after one step
    assert "the belief's ERR is not defined" in line


def test_a_study_made_of_objects_goes_to_a_new_folder_where_none_is_given(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        dafw.run(study()).close()
    folders = list((tmp_path / "outputs" / "pond").iterdir())
    assert len(folders) == 2 and all((folder / "run.nc").is_file() for folder in folders)


def test_a_folder_that_holds_a_run_is_refused(tmp_path):
    dafw.run(study(), tmp_path / "pond").close()
    with pytest.raises(RunError, match="holds a run already"):
        dafw.run(study(), tmp_path / "pond")


@pytest.mark.parametrize("what", [Pond(), "filter=none", ["filter=none", 3]])
def test_what_is_neither_a_study_nor_overrides_is_refused(what):
    with pytest.raises(ConfigurationError, match="expects a Study, or a list of overrides as strings; got"):
        dafw.run(what)


def test_readings_are_recorded_at_their_own_times_with_what_became_of_them(tmp_path):
    readings = [{"time": 3.0, "value": 1.9}, {"time": 7.0, "value": 1.8}, *LATE]
    with dafw.run(study(readings=Listed(readings, sd=0.1), filter=EnKS()), tmp_path / "pond") as run:
        first = run.isel(time=1)
        np.testing.assert_array_equal(first["observation_time"], [3.0, 7.0, 10.0, -5.0])
        np.testing.assert_array_equal(first["observation_use"], [0, 0, 0, 2])
        late = run.isel(time=4)
        assert (late["observation_time"][0], late["observation_use"][0]) == (14.0, 1)
    assert Path(run.attrs["folder"]) == (tmp_path / "pond").resolve()
