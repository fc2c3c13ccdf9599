"""Several files of readings, a file a sensor: dates, means over time, impossible values, entries, paths."""

from __future__ import annotations

import numpy as np
import pytest

from dafw import ConfigurationError, Domain, Request, StateSpace, Variable
from dafw.core.errors import ReadingsError
from dafw.core.observation import Selection
from dafw.plugins.readings.recorded import Recorded

NODES = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 100.0]])
TRIANGLES = np.array([[0, 1, 3], [0, 3, 2]], dtype=np.int32)
FIELD = StateSpace([Variable("rate", 1), Variable("gas", 4, units="ppm", coordinates=NODES, triangles=TRIANGLES)])
BEAMS = StateSpace([Variable("path_mean", 3, units="ppm")])
GROUND = Domain((0.0, 0.0, 100.0, 100.0))
HEAD = "an instrument\n{date}\nElapsed CH4 error\n"
OPTIONS = {
    "skip": 2,
    "delimiter": "space",
    "date_line": 2,
    "date_format": "%m/%d/%Y %H:%M:%S.%f",
    "columns": {"time": "Elapsed", "value": "CH4", "sd": "error"},
    "unit": "ppm",
    "start": "first",
}


def written(folder, **files):
    """Write files whose lines are (time, value), and return the pattern that names them."""
    for name, (date, rows) in files.items():
        lines = [f"{time} {value} 0.1" for time, value in rows]
        (folder / f"beam{name}.txt").write_text(HEAD.format(date=date) + "\n".join(lines) + "\n")
    return str(folder / "beam*.txt")


def taken(source, space, dt=10.0, cycles=4):
    source.suit(space, GROUND, dt)
    none = Selection(indices=np.empty(0, dtype=np.int64), covariance=np.empty(0))
    found = []
    for n in range(cycles):
        request = Request(n, n * dt, (n + 1) * dt, space, GROUND, none)
        found += source.collect(request, None, np.random.default_rng(0)).observations
    return found


TWO = {
    "1": ("05/10/2017  10:05:35.0001", [(0.0, 2.0), (5.0, 2.1), (10.0, 2.3), (15.0, -4.0), (25.0, 900.0)]),
    "2": ("05/10/2017  10:05: 9.5", [(30.5, 1.9), (40.5, 1.8)]),
}


def test_files_with_different_dates_have_one_time(tmp_path):
    source = Recorded.from_options(file=written(tmp_path, **TWO), **OPTIONS)
    table = source.usable.table
    assert table.text("sensor").tolist() == ["1", "2", "1", "1", "2", "1", "1"]
    np.testing.assert_allclose(table.number("time"), [0.0, 4.9999, 5.0, 10.0, 14.9999, 15.0, 25.0], atol=1e-9)
    assert table.date(source.usable.start).startswith("2017-05-10T10:05:35.000100")


def test_impossible_values_are_left_out_and_counted(tmp_path):
    source = Recorded.from_options(file=written(tmp_path, **TWO), lowest=1.0, highest=100.0, **OPTIONS)
    assert source.usable.counts["impossible"] == 2
    assert source.usable.table.number("value").max() == 2.3


def test_means_over_time_stand_at_the_end_of_their_span(tmp_path):
    source = Recorded.from_options(
        file=written(tmp_path, **TWO), lowest=1.0, highest=100.0, averaging=10.0, entries={"2": 0, "1": 2}, **OPTIONS
    )
    first, second = (one for one in taken(source, BEAMS) if one.time > 0.0)
    assert (first.time, second.time) == (10.0, 20.0)
    members = np.array([[7.0, 8.0, 9.0]])
    by_sensor = dict(zip(first.operator.sensors, first.values, strict=True))
    assert by_sensor == pytest.approx({"1": 2.2, "2": 1.9})  # those of (0, 10] s; that of t = 0 is a span of its own
    read = dict(zip(first.operator.sensors, first.operator.apply(members)[0], strict=True))
    assert read == {"1": 9.0, "2": 7.0}
    spread = dict(zip(first.operator.sensors, np.sqrt(first.covariance), strict=True))
    assert spread == pytest.approx({"1": 0.1 / np.sqrt(2.0), "2": 0.1})
    assert second.operator.sensors == ("2",) and second.values == pytest.approx([1.8])


def test_sensors_read_means_along_their_paths(tmp_path):
    paths = {"1": [[0.0, 0.0], [100.0, 50.0]], "2": [[10.0, 90.0], [90.0, 90.0]]}
    source = Recorded.from_options(file=written(tmp_path, **TWO), paths=paths, variable="gas", **OPTIONS)
    field = 1.0 + NODES @ [0.5, -0.25]
    for one in taken(source, FIELD):
        read = one.operator.apply(np.append(3.0, field)[np.newaxis])[0]
        for sensor, value in zip(one.operator.sensors, read, strict=True):
            assert value == pytest.approx(1.0 + np.mean(paths[sensor], axis=0) @ [0.5, -0.25])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"entries": {"1": 0}}, "the sensor '2' is not among entries: 1"),
        ({"paths": {"1": [[0.0, 0.0], [9.0, 9.0]]}, "variable": "gas"}, "the sensor '2' is not among paths: 1"),
        ({"paths": {"1": [[0, 0], [9, 9]], "2": [[0, 0], [9, 9]]}, "variable": "rate"}, "'rate' has none: use entries"),
    ],
)
def test_a_sensor_without_a_place_is_named(tmp_path, options, said):
    source = Recorded.from_options(file=written(tmp_path, **TWO), **OPTIONS, **options)
    with pytest.raises(ReadingsError, match=said):
        source.suit(FIELD, GROUND, 1.0)


def test_a_path_off_the_mesh_is_refused(tmp_path):
    paths = {"1": [[0.0, 0.0], [100.0, 50.0]], "2": [[10.0, 90.0], [190.0, 90.0]]}
    source = Recorded.from_options(file=written(tmp_path, **TWO), paths=paths, variable="gas", **OPTIONS)
    with pytest.raises(
        ConfigurationError, match=r"readings .*: the line from \(10, 90\) to \(190, 90\) leaves the mesh"
    ):
        source.suit(FIELD, GROUND, 1.0)


def test_entries_and_paths_exclude_each_other(tmp_path):
    with pytest.raises(ConfigurationError, match="entries or paths, not both"):
        Recorded.from_options(file="a.csv", entries={"1": 0}, paths={"1": [[0.0, 0.0], [1.0, 1.0]]})


@pytest.mark.parametrize(("pattern", "said"), [("none*.txt", "no such files"), ("*eam*.txt", r"expected one \*")])
def test_a_pattern_without_files_is_refused(tmp_path, pattern, said):
    written(tmp_path, **TWO)
    with pytest.raises(ReadingsError, match=said):
        _ = Recorded.from_options(file=str(tmp_path / pattern), **OPTIONS).rows


@pytest.mark.parametrize("line", [1, 3, 99])
def test_a_line_without_a_date_is_named(tmp_path, line):
    options = OPTIONS | {"date_line": line}
    with pytest.raises(ReadingsError, match=f"line {line}: expected a date as '%m/%d/%Y %H:%M:%S.%f'"):
        _ = Recorded.from_options(file=written(tmp_path, **TWO), **options).rows


def test_files_with_and_without_dates_do_not_mix(tmp_path):
    (tmp_path / "a1.csv").write_text("time,value\n2020-01-01T00:00:00Z,1\n")
    (tmp_path / "a2.csv").write_text("time,value\n5,1\n")
    with pytest.raises(ReadingsError, match=r"a2\.csv: its times are seconds"):
        _ = Recorded.from_options(file=str(tmp_path / "a*.csv"), sd=1.0).rows


def test_a_file_that_names_its_sensors_keeps_them(tmp_path):
    (tmp_path / "a1.csv").write_text("time,value,sensor\n1,1,left\n2,1,right\n")
    (tmp_path / "a2.csv").write_text("time,value\n5,1\n")
    table = Recorded.from_options(file=str(tmp_path / "a*.csv"), sd=1.0).rows
    assert table.text("sensor").tolist() == ["left", "right", "2"]
