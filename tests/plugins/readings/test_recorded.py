"""Recorded readings: a twin's file repeats the twin, slow sensors are undone, and what cannot be used is counted."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from small_plant import small_plant

import dafw
from dafw import ConfigurationError, Domain, Ensemble, Request, StateSpace, Study, Variable
from dafw.authoring.readings_checks import taken
from dafw.commands import main
from dafw.core.composition import compose, study_part
from dafw.core.errors import ReadingsError
from dafw.core.experiment import study_from
from dafw.core.observation import Selection
from dafw.plugins.filters.enks import EnKS
from dafw.plugins.filters.esmda import ESMDA
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.models.lorenz96 import Lorenz96
from dafw.plugins.observers.grid import Grid
from dafw.plugins.readings.recorded import Recorded
from dafw.plugins.readings.twin import Twin
from dafw.studies.running import run_study

NODES = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 100.0]])
TRIANGLES = np.array([[0, 1, 3], [0, 3, 2]], dtype=np.int32)
SPACE = StateSpace([Variable("gas", 4, units="mg m-3", coordinates=NODES), Variable("rate", 1, units="g s-1")])
WALL = np.array([[40.0, 40.0], [60.0, 40.0], [60.0, 60.0], [40.0, 60.0]])
GROUND = Domain((0.0, 0.0, 100.0, 100.0), (WALL,), ("shed",), TRIANGLES, origin=(8.0, 50.0))
PLANE = 10.0 + 2.0 * NODES[:, 0] - NODES[:, 1]
HEAD = "time,x,y,value\n"


def recorded(tmp_path, text, **options):
    """Return the source of a CSV file, with a standard deviation of 0.5 unless given."""
    (tmp_path / "a.csv").write_text(text)
    return Recorded.from_options(**{"file": str(tmp_path / "a.csv"), "sd": 0.5, **options})


def collected(source, cycles=5, dt=1.0, space=SPACE, domain=GROUND):
    """Return what a source gives in each cycle."""
    source.suit(space, domain, dt)
    nothing = Selection(indices=np.empty(0, dtype=np.int64), covariance=np.empty(0))
    requests = [Request(n, n * dt, (n + 1) * dt, space, domain, nothing) for n in range(cycles)]
    return [source.collect(request, None, np.random.default_rng(0)) for request in requests]


def values(source, **options):
    """Return times, values and standard deviations of all readings that a source gives."""
    found = [one for got in collected(source, **options) for one in got.observations]
    times = np.concatenate([np.full(one.values.size, one.time) for one in found])
    return times, np.concatenate([one.values for one in found]), np.sqrt(np.concatenate([o.covariance for o in found]))


def plant(**more):
    """Return a small twin with one drone."""
    return small_plant([[0.0, -30.0]], **more)


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    folder = tmp_path_factory.mktemp("twin") / "run"
    run_study(plant(), folder)
    return folder


@pytest.mark.parametrize("end", ["csv", "nc", "geojson"])
def test_the_file_of_a_twin_repeats_its_belief_to_the_bit(end, twin, tmp_path, capsys):
    path = tmp_path / f"a.{end}"
    assert main(["readings", str(twin), "--to", str(path)]) == 0
    assert capsys.readouterr().out == f"{path}\n"
    run_study(plant(readings=Recorded.from_options(file=str(path)), truth=None), tmp_path / "run")
    with dafw.open_run(twin) as first, dafw.open_run(tmp_path / "run") as second:
        assert np.isfinite(first["observation_value"]).sum() > 5
        for name in ("concentration_mean", "concentration_spread", "wind_speed_members", "observation_value"):
            np.testing.assert_array_equal(first[name], second[name], name)
        assert [str(name) for name in second["sensor_name"].values] == ["drone 0"]
        assert (second["observation_sensor"].values[1:, 0] == 0).all()


def test_a_run_on_entries_repeats_itself_too(tmp_path):
    study = {"model": Lorenz96(), "filter": ETKF(), "members": 8, "cycles": 6, "seed": 1001}
    run_study(Study(**study, truth=Lorenz96(), observer=Grid()), tmp_path / "first")
    assert main(["readings", str(tmp_path / "first"), "--to", str(tmp_path / "a.csv")]) == 0
    again = Recorded.from_options(file=str(tmp_path / "a.csv"), place="entry")
    run_study(Study(**study, readings=again), tmp_path / "second")
    with dafw.open_run(tmp_path / "first") as first, dafw.open_run(tmp_path / "second") as second:
        np.testing.assert_array_equal(first["x_mean"], second["x_mean"])


def test_late_readings_of_a_run_are_late_again(tmp_path):
    text = "time,arrives,x,y,value,sd\n1.0,,0,0,5,0.5\n1.5,4,100,0,6,0.5\n3,,0,100,7,0.5\n"
    study = {"model": Still(), "members": 5, "cycles": 5, "seed": 1000}
    first = recorded(tmp_path, text)
    run_study(Study(**study, filter=EnKS(), readings=first), tmp_path / "first")
    assert main(["readings", str(tmp_path / "first"), "--to", str(tmp_path / "b.csv")]) == 0
    again = Recorded.from_options(file=str(tmp_path / "b.csv"))
    run_study(Study(**study, filter=EnKS(), readings=again), tmp_path / "second")
    uses = [json.loads((tmp_path / one / "summary.json").read_text())["readings"] for one in ("first", "second")]
    assert uses[0] == uses[1] and uses[0]["late_in_window"] == 1 and uses[0]["on_time"] == 2
    with dafw.open_run(tmp_path / "first") as one, dafw.open_run(tmp_path / "second") as other:
        np.testing.assert_array_equal(one["gas_smoothed_mean"], other["gas_smoothed_mean"])


class Still(dafw.Model):
    """Nothing moves."""

    dt, space, domain = 1.0, SPACE, GROUND

    def initial(self, n_members, rng):
        return np.stack([rng[number].normal(5.0, 2.0, 5) for number in range(n_members)])

    def step(self, members, t, rng):
        return members


def test_the_example_reaches_the_conformance_kit():
    found = taken(lambda: Recorded.from_options(**Recorded.check_options()))
    assert sum(len(got.observations) for _, got in found) >= 4


def test_a_reading_between_the_nodes_is_interpolated_and_one_at_a_node_is_exact(tmp_path):
    text = HEAD + "1,25,75,0\n1,100,100,0\n1,70,10,0\n"
    ((one,), *_) = [got.observations for got in collected(recorded(tmp_path, text))]
    predicted = one.operator.apply(np.append(PLANE, 3.0)[np.newaxis])
    np.testing.assert_allclose(predicted, [[-15.0, 110.0, 140.0]], rtol=1e-12)
    assert predicted[0, 1] == PLANE[3]
    np.testing.assert_array_equal(one.operator.coordinates, [[25, 75], [100, 100], [70, 10]])


def test_longitude_and_latitude_are_places_in_the_plane_of_the_site(tmp_path):
    from pyproj import Geod

    lon, lat, _ = Geod(ellps="WGS84").fwd(-8.0, 50.0, 30.0, 50.0)
    ground = replace(GROUND, origin=(-8.0, 50.0))
    for shift in (0.0, 360.0):
        text = f"time,lon,lat,value\n1,{lon + shift!r},{lat!r},0\n"
        ((one,), *_) = [got.observations for got in collected(recorded(tmp_path, text), domain=ground)]
        np.testing.assert_allclose(one.operator.coordinates, [[25.0, 50.0 * np.sqrt(0.75)]], atol=1e-3)
    moved = recorded(tmp_path, text, origin=[lon, lat])
    ((one,), *_) = [got.observations for got in collected(moved)]
    np.testing.assert_allclose(one.operator.coordinates, [[0.0, 0.0]], atol=1e-8)
    nowhere = Domain(GROUND.bounds, triangles=TRIANGLES)
    with pytest.raises(ReadingsError, match="has no place on Earth: expected the option origin"):
        recorded(tmp_path, text).suit(SPACE, nowhere, 1.0)


def test_what_cannot_be_used_is_counted_by_its_reason(tmp_path, capsys):
    text = HEAD + (
        "-3,0,0,1\n0,0,0,1\n1,0,0,1\n1,0,0,1\n2,101,0,1\n2,50,50,1\n2,40,50,1\n3,0,0,\n,0,0,1\n3,,0,1\n3,nan,0,1\n99,0,0,1\n"
    )
    source = recorded(tmp_path, text)
    run_study(Study(model=Still(), filter=ETKF(), readings=source, members=4, cycles=3), tmp_path / "run")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["readings_left_out"] == {"incomplete": 4, "doubled": 1, "outside": 1, "in_building": 1}
    assert summary["readings"]["before_start"] == 2 and summary["readings"]["on_time"] == 2
    warned = capsys.readouterr().err
    assert ": 4 rows are left out, incomplete (summary.json counts them)" in warned
    assert "1 row is left out, in building" in warned
    log = (tmp_path / "run" / "run.log").read_text()
    assert "12 rows in" in log and "of t = -3 to 99 s" in log and "1 inside a building" in log


@pytest.mark.parametrize("dt", [1.0, 0.1, 1.0 / 3.0])
def test_every_reading_is_given_once_in_the_cycle_it_belongs_to(dt, tmp_path):
    ends = np.cumsum(np.full(20, dt))  # rounded as the loop rounds
    times = np.concatenate([ends, np.round(dt * np.arange(1, 20), 12), np.linspace(0.01, 19.9, 37) * dt])
    text = HEAD + "".join(f"{time!r},{number % 100},0,{number}\n" for number, time in enumerate(times.tolist()))
    source = recorded(tmp_path, text)
    source.suit(SPACE, GROUND, dt)
    seen = []
    nothing = Selection(indices=np.empty(0, dtype=np.int64), covariance=np.empty(0))
    now = 0.0
    for cycle in range(20):
        request = Request(cycle, now, now + dt, SPACE, GROUND, nothing)
        for one in source.collect(request, None, np.random.default_rng(0)).observations:
            seen += one.values.tolist()
            assert now - 1e-9 < one.time <= request.end
        now += dt
    assert sorted(seen) == list(range(len(times)))


def test_units_are_those_of_the_variable_and_a_reference_says_what_1_is(tmp_path):
    text = "time,x,y,value,unit,sd\n1,0,0,2,g m-3,0.1\n2,0,0,3,mg/m3,0.2\n3,0,0,4,,0.3\n"
    _, value, sd = values(recorded(tmp_path, text))
    np.testing.assert_allclose(value, [2000.0, 3.0, 4.0], rtol=1e-12)
    np.testing.assert_allclose(sd, [100.0, 0.2, 0.3], rtol=1e-12)
    _, value, _ = values(recorded(tmp_path, text, unit="g m-3", reference="500 mg m-3"))
    np.testing.assert_allclose(value, [4.0, 6.0, 8.0], rtol=1e-12)
    with pytest.raises(
        ReadingsError, match=r"line 2, column 'value': the unit 'ppm' cannot be converted into 'mg m-3'"
    ):
        collected(recorded(tmp_path, text, unit="ppm"))


def test_every_sensor_has_its_own_errors(tmp_path):
    text = "time,x,y,value,sensor,sd\n1,0,0,10,a,\n2,0,0,10,b,\n3,0,0,10,b,0.1\n4,0,0,10,,\n"
    own = {"b": {"sd": 2.0, "background": 4.0, "relative_sd": 0.25}}
    _, value, sd = values(recorded(tmp_path, text, sensors=own))
    np.testing.assert_array_equal(value, [10.0, 6.0, 6.0, 10.0])
    np.testing.assert_allclose(sd, [0.5, 2.5, np.hypot(0.1, 1.5), 0.5], rtol=1e-12)
    with pytest.raises(
        ReadingsError, match=r"line 2: has no standard deviation: expected a column 'sd' or the option sd"
    ):
        collected(recorded(tmp_path, text, sd=None))
    with pytest.raises(ReadingsError, match=r"no sensor 'c' \(there are: a, b, \)"):
        collected(recorded(tmp_path, text, sensors={"c": {}}))


def test_every_sensor_is_averaged_over_its_own_time(tmp_path):
    rows = [(n, name) for n in range(1, 7) for name in "abc"]
    text = "time,x,y,value,sensor\n" + "".join(f"{n},0,0,{n},{name}\n" for n, name in rows)
    source = recorded(tmp_path, text, averaging=2.0, sensors={"b": {"averaging": 3.0}, "c": {"averaging": None}})
    source.suit(SPACE, GROUND, 1.0)
    table, found = source.usable.table, {}
    np.testing.assert_array_equal(table.number("time"), np.sort(table.number("time")))
    for time, name, value, sd in zip(
        table.number("time"), table.text("sensor"), table.number("value"), table.number("sd"), strict=True
    ):
        found.setdefault(name, []).append((time, value, sd))
    few, more = 0.5 / np.sqrt(2.0), 0.5 / np.sqrt(3.0)
    np.testing.assert_allclose(found["a"], [(2, 1.5, few), (4, 3.5, few), (6, 5.5, few)], rtol=1e-12)
    np.testing.assert_allclose(found["b"], [(3, 2.0, more), (6, 5.0, more)], rtol=1e-12)
    assert found["c"] == [(n, n, 0.5) for n in range(1, 7)]


def test_a_mean_is_known_when_the_last_of_its_readings_has_arrived(tmp_path):
    text = "time,x,y,value,sensor,arrives\n1,0,0,1,a,9\n2,0,0,1,a,\n3,0,0,1,a,\n3.5,0,0,1,a,3.7\n3.6,0,0,1,b,\n"
    source = recorded(tmp_path, text, sensors={"a": {"averaging": 2.0}})
    given = [sorted(one.time for one in got.observations) for got in collected(source, cycles=9)]
    assert given == [[], [], [], [3.6, 4.0], [], [], [], [], [2.0]] and source.cycles_covered(1.0) == 9
    again = "time,x,y,value,sensor,arrives\n1,0,0,1,a,\n1,0,0,3,a,4\n2,0,0,1,a,\n2,0,0,1,a,2\n3,0,0,1,a,\n"
    given = [[one.time for one in got.observations] for got in collected(recorded(tmp_path, again, repeated="mean"))]
    assert given == [[], [2.0], [3.0], [1.0], []]


def test_means_have_their_span_whether_averaged_here_or_by_the_instrument(tmp_path):
    text = "time,x,y,value,sensor,span\n1,0,0,1,a,\n2,0,0,3,a,\n2,0,0,5,b,60\n3,0,0,7,b,0\n"
    found = collected(recorded(tmp_path, text, sensors={"a": {"averaging": 2.0}}))
    operators = [one.operator for got in found for one in got.observations]
    spans = {(name, span) for one in operators for name, span in zip(one.sensors, one.spans, strict=True)}
    assert spans == {("a", 2.0), ("b", 60.0), ("b", 0.0)}
    plain = collected(recorded(tmp_path, HEAD + "1,0,0,1\n"))
    assert plain[0].observations[0].operator.spans is None


def test_means_of_a_run_are_means_again(tmp_path):
    """The belief of a filter that re-runs is repeated to the bit from the readings that the first run wrote."""
    rows = "".join(f"{n},100,0,{5 + n % 3}\n" for n in range(1, 7))
    study = {"model": Drift(), "filter": ESMDA(every=6), "members": 8, "cycles": 6, "seed": 1000}
    run_study(Study(**study, readings=recorded(tmp_path, HEAD + rows, averaging=3.0)), tmp_path / "first")
    assert main(["readings", str(tmp_path / "first"), "--to", str(tmp_path / "b.csv")]) == 0
    assert "span" in (tmp_path / "b.csv").read_text().splitlines()[0]
    again = Recorded.from_options(file=str(tmp_path / "b.csv"))
    run_study(Study(**study, readings=again), tmp_path / "second")
    run_study(Study(**study, readings=Recorded.from_options(file=str(without_span(tmp_path)))), tmp_path / "third")
    runs = [dafw.open_run(tmp_path / one)["gas_mean"].load() for one in ("first", "second", "third")]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert np.abs(runs[0] - runs[2])[-1].max() > 0.1


def without_span(folder):
    """Return the path of the same file of readings without its column ``span``."""
    rows = [line.split(",") for line in (folder / "b.csv").read_text().splitlines()]
    place = rows[0].index("span")
    (folder / "c.csv").write_text("".join(",".join(row[:place] + row[place + 1 :]) + "\n" for row in rows))
    return folder / "c.csv"


class Drift(dafw.Model):
    """The gas grows by its rate."""

    dt, space, domain = 1.0, SPACE, GROUND

    def initial(self, n_members, rng):
        return np.stack([rng[number].normal(5.0, 2.0, 5) for number in range(n_members)])

    def step(self, members, t, rng):
        return members + np.array([1.0, 1.0, 1.0, 1.0, 0.0]) * members[:, 4:]


def test_a_study_may_end_with_the_last_reading(tmp_path):
    source = recorded(tmp_path, "time,arrives,x,y,value\n0.5,,0,0,1\n2.5,6.5,0,0,1\n")
    assert [source.cycles_covered(dt) for dt in (0.1, 0.5, 1.0, 100.0)] == [65, 13, 7, 1]
    found = study_from(study_part(compose(["experiment=recorded", "cycles=null"])))
    last = found.readings.usable.table.number("time").max()
    assert (found.cycles - 1) * found.model.dt < last <= found.cycles * found.model.dt
    with pytest.raises(ConfigurationError, match=r"cycles=null goes with readings that have a last one.*'twin'"):
        study_from(study_part(compose(["cycles=null"])))


def test_a_share_of_something_else_is_said(tmp_path):
    """A concentration relative to a release has the unit 1, into which ppm can be converted without a word."""
    relative = StateSpace([Variable("gas", 4, units="1", coordinates=NODES)])
    text = "time,x,y,value,unit\n1,0,0,5,ppm\n2,0,0,1,1\n"
    source = recorded(tmp_path, text)
    source.suit(relative, GROUND, 1.0)
    assert "1 ppm is taken as 1e-06" in source.notes()[0] and source.notes()[0].count("is taken as") == 1
    told = recorded(tmp_path, text, reference="10 ppm")
    told.suit(relative, GROUND, 1.0)
    assert "is taken as" not in told.notes()[0]


def test_a_slow_sensor_is_undone_exactly(tmp_path):
    # The twin's own slow sensor, at one node whose concentration jumps about: its noise is the only difference.
    rng, fields, memory = np.random.default_rng(1), [], {}
    source, lines = Twin(lag=4.0), ["time,x,y,value,sensor"]
    for cycle in range(12):
        state = rng.random((1, 5))
        fields.append(state[0, 1])
        seen = Selection(indices=np.array([1]), covariance=np.array([1e-24]), sensors=("slow",))
        request = Request(cycle, cycle * 1.0, cycle + 1.0, SPACE, GROUND, seen, Ensemble(state, SPACE, cycle + 1.0))
        got = source.collect(request, memory, rng)
        memory = got.memory
        lines.append(f"{cycle + 1.0},100,0,{float(got.observations[0].values[0])!r},slow")
    undone = recorded(tmp_path, "\n".join(lines), response_time=4.0)
    times, value, sd = values(undone, cycles=12)
    np.testing.assert_array_equal(times, np.arange(2.0, 13.0))  # the first only says where the sensor starts
    np.testing.assert_allclose(value, fields[1:], atol=1e-10)
    a = np.exp(-1.0 / 4.0)
    np.testing.assert_allclose(sd, 0.5 * np.hypot(1.0, a) / (1.0 - a), rtol=1e-12)
    assert collected(undone)[0].left_out == {"slow_start": 1}


def test_what_a_slow_sensor_met_is_known_when_both_of_its_readings_are(tmp_path):
    text = "time,x,y,value,sd,arrives\n1,0,0,1,1,\n2,0,0,2,1,9\n3,0,0,3,1,\n"
    cycles = collected(recorded(tmp_path, text, response_time=1.0), cycles=9)
    assert [[one.time for one in taken.observations] for taken in cycles] == [*[[]] * 8, [2.0, 3.0]]


def test_the_errors_of_an_undone_sensor_are_as_large_as_they_are_said_to_be(tmp_path):
    rng = np.random.default_rng(2)
    lines = [f"{n + 1},0,0,{7.0 + 0.5 * rng.standard_normal()!r}" for n in range(1500)]
    _, value, sd = values(recorded(tmp_path, HEAD + "\n".join(lines), response_time=2.0), cycles=1500)
    assert abs(value.mean() - 7.0) < 0.1
    np.testing.assert_allclose(value.std(), sd[0], rtol=0.1)


def test_below_the_detection_limit_only_that_is_known(tmp_path):
    text = HEAD + "1,0,0,0.4\n2,0,0,-0.1\n3,0,0,2\n"
    _, value, sd = values(recorded(tmp_path, text, detection_limit=1.2))
    np.testing.assert_allclose(value, [0.6, 0.6, 2.0], rtol=1e-12)
    spread = np.sqrt(0.25 + 1.44 / 12.0)
    np.testing.assert_allclose(sd, [spread, spread, 0.5], rtol=1e-12)


def test_the_limits_of_sensors_are_told_in_the_units_of_the_variable(tmp_path):
    """The left sensor's limit is 1.2 ppm, the right one's 2 ppm; the variable counts in 10 ppm."""
    text = "time,x,y,value,unit,sensor\n1,0,0,0.4,ppm,left\n1,2,0,1.5,ppm,right\n2,0,0,1.5,ppm,left\n"
    own = {"left": {"detection_limit": 1.2}, "right": {"detection_limit": 2.0}}
    asked = {"sensors": own, "reference": "10 ppm", "sd": 0.1}
    first, second = (one for got in collected(recorded(tmp_path, text, **asked)) for one in got.observations)
    np.testing.assert_allclose(first.operator.limits, [0.12, 0.2], rtol=1e-12)
    np.testing.assert_array_equal(second.operator.limits, [np.nan])
    np.testing.assert_allclose(first.values, [0.06, 0.1], rtol=1e-12)


def test_a_limit_in_another_scale_of_temperature_is_converted_as_values_are(tmp_path):
    """What is below 5 degC lies between 0 and 5 degC, for a variable in kelvin."""
    text = "time,x,y,value,unit\n1,0,0,2,degC\n2,0,0,30,degC\n3,0,0,280,K\n"
    asked = {"reference": "K", "sensors": {"": {"detection_limit": 5.0}}}
    found = [one for got in collected(recorded(tmp_path, text, **asked)) for one in got.observations]
    np.testing.assert_allclose([one.values[0] for one in found], [275.65, 303.15, 280.0], rtol=1e-12)
    np.testing.assert_allclose([one.operator.limits[0] for one in found], [278.15, np.nan, np.nan], rtol=1e-12)
    np.testing.assert_allclose([one.variance[0] for one in found], [0.25 + 25.0 / 12.0, 0.25, 0.25], rtol=1e-9)


def test_readings_at_the_same_time_are_kept_or_the_first_or_their_mean(tmp_path):
    text = "time,x,y,value,sensor\n1,0,0,1,a\n1,2,0,3,a\n1,0,0,9,b\n2,0,0,5,a\n"
    for choice, expected in (("keep", [1, 3, 9, 5]), ("first", [1, 9, 5]), ("mean", [2, 9, 5])):
        source = recorded(tmp_path, text, repeated=choice)
        _, value, sd = values(source)
        np.testing.assert_array_equal(value, expected)
        assert source.usable.repeated == 1 and source.usable.counts["repeated"] == (choice != "keep")
    np.testing.assert_allclose(sd, [0.5 / np.sqrt(2.0), 0.5, 0.5], rtol=1e-12)
    with pytest.raises(ReadingsError, match="line 3: a sensor with a response time has two readings at this time"):
        collected(recorded(tmp_path, text, response_time=1.0))


def test_dates_need_a_start(tmp_path):
    text = "time,x,y,value\n2022-12-12T10:00:05Z,0,0,1\n2022-12-12T10:00:07Z,0,0,2\n"
    with pytest.raises(
        ReadingsError, match=r"the first of a reading is 2022-12-12T10:00:05Z: expected the option start"
    ):
        collected(recorded(tmp_path, text))
    for start in (7.0, "yesterday"):
        with pytest.raises(ReadingsError, match="expected the option start"):
            collected(recorded(tmp_path, text, start=start))
    assert values(recorded(tmp_path, text, start="2022-12-12T12:00:04+02:00"))[0].tolist() == [1.0, 3.0]
    assert values(recorded(tmp_path, text, start="first"))[0].tolist() == [0.0, 2.0]
    with pytest.raises(ReadingsError, match="expected the option start in seconds or 'first', got '2022"):
        collected(recorded(tmp_path, HEAD + "5,0,0,1\n", start="2022-12-12"))
    assert values(recorded(tmp_path, HEAD + "5,0,0,1\n", start=3.0))[0].tolist() == [2.0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEAD, "none of its 0 rows can be used: it has none"),
        (HEAD + "1,999,0,5\n", "none of its 1 rows can be used: 1 outside the site"),
        (HEAD + "0,1,0,5\n1,50,50,5\n", "1 inside a building, 1 not after the start of the study"),
        ("time,value\n1,5\n", "has no places: expected columns x and y, lon and lat, or entry"),
        (
            "time,entry,value\n1,4,5\n",
            "line 2, column 'entry': expected an entry below 4, the size of the variable 'gas'",
        ),
    ],
)
def test_a_file_that_does_not_fit_the_study_is_refused_before_it_begins(text, said, tmp_path):
    with pytest.raises(ReadingsError, match="readings file") as caught:
        recorded(tmp_path, text).suit(SPACE, GROUND, 1.0)
    assert said in str(caught.value)


def test_a_variable_without_places_needs_none(tmp_path):
    _, value, _ = values(recorded(tmp_path, "time,value\n1,5\n", variable="rate"))
    assert value.tolist() == [5.0]
    with pytest.raises(ConfigurationError, match="no state variable 'level'"):
        collected(recorded(tmp_path, "time,value\n1,5\n", variable="level"))


def test_a_run_without_readings_has_no_file(tmp_path, capsys):
    run_study(Study(model=Still(), truth=Still(), filter=ETKF(), members=3, cycles=1), tmp_path / "run")
    assert main(["readings", str(tmp_path / "run")]) == 2
    assert "it has no readings" in capsys.readouterr().err


def test_the_command_says_what_a_file_holds(tmp_path, capsys):
    text = "Stamp;Gas (ppm);Lon;Lat;Battery\n"
    for seconds, value in (("40 5", "400"), ("39 5", "-"), ("40 7", "402")):
        text += f"A 221212 1012{seconds};{value};8;50;3\n"
    (tmp_path / "log.csv").write_text(text)
    asked = ["columns.time=Stamp", "readings.columns.value=gas", "time_format='A %y%m%d %H%M%S*'", "sd=5"]
    assert main(["readings", str(tmp_path / "log.csv"), *asked]) == 0
    assert "needed    its times are dates" in capsys.readouterr().out
    assert main(["readings", str(tmp_path / "log.csv"), *asked, "start='2022-12-12T10:12:30Z'"]) == 0
    said = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    for line in (
        "time from 'Stamp': 2022-12-12T10:12:39Z to 2022-12-12T10:12:40Z, 1 times back",
        "value from 'Gas (ppm)': 400 to 402, 1 missing",
        "units ppm",
        "not used Battery",
        "t = 0 2022-12-12T10:12:30Z",
        "times t = 10 to 10 s, 0 not after t = 0",
        "readings 2",
        "repeated 1 of a sensor at a time of which it has another one: keep",
        "left out 1 without a time, a value or a place",
    ):
        assert line in said, said


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("2,10,20,1e200,0.5", "line 3, column 'value': expected a number up to 1e+100 that can be computed with"),
        ("2,10,20,1,1e200", "line 3, column 'sd': expected a number from 1e-100 up to 1e+100"),
        ("2,10,20,1,1e-200", "got 1e-200"),
    ],
)
def test_numbers_whose_squares_are_none_are_refused(row, said, tmp_path):
    source = recorded(tmp_path, f"time,x,y,value,sd\n1,10,20,1,0.5\n{row}\n", averaging=2.0)
    with pytest.raises(ReadingsError) as caught:
        source.suit(SPACE, GROUND, 1.0)
    assert said in str(caught.value)
