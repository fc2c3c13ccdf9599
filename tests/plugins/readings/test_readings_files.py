"""Files of readings: what is written is read again to the last bit, in every format; nothing makes a reader crash."""

from __future__ import annotations

import json

import numpy as np
import pytest
import xarray
from conventions import breaches
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tables import require_same, tables, written_and_read

from dafw.core.errors import ReadingsError
from dafw.core.options import build
from dafw.plugins.readings.files.any_file import read_table
from dafw.plugins.readings.files.options import FileOptions
from dafw.plugins.readings.files.units import linear

STEADY = settings(
    deadline=None, derandomize=True, max_examples=40, suppress_health_check=[HealthCheck.too_slow], database=None
)
FORMATS = (".csv", ".nc", ".geojson")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("files")


def read(path, text, **options):
    """Return the table in a file that has this text."""
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_table(build(FileOptions, {"file": str(path), **options}, "file"))


@pytest.mark.parametrize("end", FORMATS)
def test_what_is_written_is_read_again_to_the_last_bit(end, folder):
    @STEADY
    @given(tables())
    def holds(table):
        require_same(table, written_and_read(table, folder / f"a{end}"))

    holds()


def test_from_one_format_into_the_next_nothing_changes(folder):
    @settings(STEADY, max_examples=15)
    @given(tables())
    def holds(table):
        found = table
        for end in (*FORMATS, ".csv"):
            found = written_and_read(found, folder / f"b{end}")
        require_same(table, found)

    holds()


WORDS = st.sampled_from(
    [
        "time",
        "value",
        "x",
        "y",
        "lon",
        "lat",
        "sd",
        "1",
        "-1e999",
        "nan",
        "2022-01-01T00:00:00Z",
        '"',
        ",",
        ";",
        "\n",
        "\r",
    ]
)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.sampled_from(["Feature", "Point", "1", "time"]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["type", "features", "geometry", "properties", "coordinates", "time", "value"]), inner
        )
    ),
    max_leaves=12,
)
FEATURE = st.fixed_dictionaries(
    {
        "type": st.just("Feature"),
        "geometry": st.just({"type": "Point", "coordinates": [8.0, 50.0]}) | JSON,
        "properties": st.dictionaries(
            st.sampled_from(["time", "value", "x", "y", "sd", "unit", "sensor", "arrives"]), JSON
        ),
    }
)


@STEADY
@given(
    text=st.text(max_size=200) | st.lists(WORDS | st.just(","), max_size=60).map("".join), raw=st.binary(max_size=100)
)
def test_no_text_crashes_the_reader_of_csv(folder, text, raw):
    for content in (
        text.encode("utf-8", "surrogatepass"),
        raw,
        b"time,value,x,y\n" + raw,
        f"time,value\n{text}".encode("utf-8", "replace"),
    ):
        _table_or_line(folder / "c.csv", content)


@STEADY
@given(document=JSON, features=st.lists(FEATURE, max_size=3), raw=st.binary(max_size=60))
def test_no_json_crashes_the_reader_of_geojson(folder, document, features, raw):
    for content in (
        document,
        {"type": "FeatureCollection", "features": features},
        {"type": "FeatureCollection", "features": document},
    ):
        _table_or_line(folder / "c.geojson", json.dumps(content).encode())
    _table_or_line(folder / "c.geojson", raw)


@STEADY
@given(data=st.data())
def test_no_layout_crashes_the_reader_of_netcdf(folder, data):
    dims = ("obs", "station")
    dataset = xarray.Dataset()
    for name in data.draw(
        st.lists(st.sampled_from(["time", "value", "x", "y", "lat", "sd", "sensor", "index"]), unique=True)
    ):
        used = data.draw(st.lists(st.sampled_from(dims), unique=True, max_size=2))
        kind = data.draw(st.sampled_from(["f8", "i4", "U", "i1"]))
        values = np.full([{"obs": 3, "station": 2}[dim] for dim in used], 1.0)
        attributes = data.draw(
            st.dictionaries(
                st.sampled_from(["units", "standard_name", "cf_role", "instance_dimension", "sample_dimension"]),
                st.sampled_from(
                    [
                        "s",
                        "seconds since 2022-01-01",
                        "days since never",
                        "time",
                        "station",
                        "obs",
                        "trajectory_id",
                        "ppm",
                    ]
                ),
                max_size=3,
            )
        )
        dataset[name] = (used, values.astype(str) if kind == "U" else values.astype(kind), attributes)
    path = folder / "c.nc"
    path.unlink(missing_ok=True)
    dataset.to_netcdf(path, engine="netcdf4")
    _table_or_line(path, None)


def _table_or_line(path, content):
    if content is not None:
        path.write_bytes(content)
    try:
        read_table(FileOptions(str(path)))
    except ReadingsError as error:
        assert path.name in str(error)


def test_a_file_written_by_hand_is_understood(tmp_path):
    text = """Time (min); "Longitude";Latitude; CO2 (ppm) ; Notes
0;8,001;50,001;412,5;
 2 ;8.001;50.001;-;no bag
4;8,001;50,001;413;
"""
    with pytest.raises(ReadingsError, match=r"line 3, column .Longitude.: expected a number, got .8.001."):
        read(tmp_path / "a.csv", text, decimal="comma", columns={"value": "co2"})
    table = read(
        tmp_path / "a.csv", text.replace("8.001;50.001", "8,001;50,001"), decimal="comma", columns={"value": "co2"}
    )
    np.testing.assert_array_equal(table.number("time"), [0.0, 120.0, 240.0])
    np.testing.assert_array_equal(table.number("value"), [412.5, np.nan, 413.0])
    np.testing.assert_array_equal(table.number("lon"), [8.001, 8.001, 8.001])
    assert table.text("unit").tolist() == ["ppm"] * 3 and table.others == ("Notes",)
    assert table.rows.tolist() == [2, 3, 4]


def test_dates_of_every_zone_and_of_other_formats_are_the_same_times(tmp_path):
    text = "time,value\n2022-12-12T10:12:40Z,1\n2022-12-12T11:12:41.5+01:00,2\n2022-12-12 10:12:39,3\n"
    table = read(tmp_path / "a.csv", text)
    np.testing.assert_array_equal(table.number("time"), [1.0, 2.5, 0.0])
    stamped = "time,value\nUTC 221212 101240 5 9 ,1\nUTC 221212 101241 15 9,2\n"
    table = read(tmp_path / "b.csv", stamped, time_format="UTC %y%m%d %H%M%S*")
    np.testing.assert_array_equal(table.number("time"), [0.0, 1.0])
    assert table.epoch.isoformat() == "2022-12-12T10:12:40+00:00"


def layouts():
    """Yield datasets with the same six readings of two stations, each in another layout of CF."""
    time, value, x = np.array([[0.0, 1, 2], [0, 1, 2]]), np.array([[1.0, 2, 3], [4, 5, 6]]), [10.0, 20.0]
    place = {"x": ("station", x), "y": ("station", [0.0, 5.0])}
    name = {"station_name": ("station", ["a", "b"], {"cf_role": "timeseries_id"})}
    units = {"units": "ppm", "coordinates": "time x y"}
    flat = {"time": ("obs", time.ravel()), "co2": ("obs", value.ravel(), units)}
    yield "orthogonal", {"time": ("time", time[0]), "co2": (("station", "time"), value, units), **place, **name}
    yield "transposed", {"time": ("time", time[0]), "co2": (("time", "station"), value.T, units), **place, **name}
    yield "incomplete", {"time": (("station", "obs"), time), "co2": (("station", "obs"), value, units), **place, **name}
    rows = ("station", np.array([3, 3], dtype="i4"), {"sample_dimension": "obs"})
    yield "contiguous", {**flat, "row_size": rows, **place, **name}
    index = ("obs", np.array([0, 0, 0, 1, 1, 1], dtype="i4"), {"instance_dimension": "station"})
    yield "indexed", {**flat, "which": index, **place, **name}


@pytest.mark.parametrize(("layout", "variables"), [pytest.param(n, v, id=n) for n, v in layouts()])
def test_every_layout_of_stations_holds_the_same_readings(layout, variables, tmp_path):
    xarray.Dataset(variables, attrs={"featureType": "timeSeries"}).to_netcdf(tmp_path / "a.nc", engine="netcdf4")
    table = read_table(FileOptions(str(tmp_path / "a.nc")))
    found = zip(
        table.number("time"),
        table.number("value"),
        table.number("x"),
        table.number("y"),
        table.text("sensor"),
        strict=True,
    )
    expected = [(t, 1.0 + 3 * s + t, 10.0 + 10 * s, 5.0 * s, "ab"[s]) for s in (0, 1) for t in (0.0, 1.0, 2.0)]
    assert sorted(found, key=lambda one: one[1]) == expected
    assert set(table.text("unit")) == {"ppm"}


def test_a_shorter_series_is_padded_and_a_trajectory_has_dates_and_packed_numbers(tmp_path):
    time = np.array([[0.0, 30.0, 60.0], [0.0, 30.0, np.nan]])
    value = np.array([[4100, 4150, 4200], [4000, 4050, -1]], dtype="i2")
    dataset = xarray.Dataset(
        {
            "t": (("trajectory", "obs"), time, {"standard_name": "time", "units": "minutes since 2022-12-12 10:00:00"}),
            "co2": (("trajectory", "obs"), value, {"units": "ppm", "scale_factor": 0.1, "_FillValue": np.int16(-1)}),
            "longitude": (("trajectory", "obs"), 8.0 + 0 * time, {"standard_name": "longitude"}),
            "latitude": (("trajectory", "obs"), 50.0 + 0 * time, {"standard_name": "latitude"}),
        },
        attrs={"featureType": "trajectory"},
    )
    dataset.to_netcdf(tmp_path / "a.nc", engine="netcdf4")
    table = read_table(FileOptions(str(tmp_path / "a.nc")))
    assert len(table) == 5 and table.epoch.isoformat() == "2022-12-12T10:00:00+00:00"
    np.testing.assert_array_equal(table.number("time"), [0.0, 1800.0, 3600.0, 0.0, 1800.0])
    np.testing.assert_allclose(table.number("value"), [410.0, 415.0, 420.0, 400.0, 405.0], rtol=1e-12)


def test_stations_are_written_as_stations_and_vehicles_as_trajectories(tmp_path):
    text = "time,value,x,y,sensor\n1,5,0,0,a\n1,6,9,0,b\n2,7,{},0,a\n"
    for place, feature in (("0", "timeSeries"), ("3", "trajectory")):
        written_and_read(read(tmp_path / "a.csv", text.format(place)), tmp_path / "a.nc")
        with xarray.open_dataset(tmp_path / "a.nc", decode_times=False) as dataset:
            assert dataset.attrs["featureType"] == feature
            assert dataset["value"].encoding["coordinates"] == "time x y"
        assert breaches(tmp_path / "a.nc") == ["value has no units"]  # none are told


@pytest.mark.parametrize(
    ("unit", "wanted", "expected"),
    [
        ("ppm", "1", (0.0, 1e-6)),
        ("ppbv", "ppm", (0.0, 1e-3)),
        ("mg/m3", "kg m-3", (0.0, 1e-6)),
        ("µg m-3", "mg/m³", (0.0, 1e-3)),
        ("umol mol-1", "1", (0.0, 1e-6)),
        ("%", "1e-2", (0.0, 1.0)),
        ("degC", "K", (273.15, 1.0)),
        ("g m-3", "250 mg m-3", (0.0, 4.0)),
    ],
)
def test_units_are_converted(unit, wanted, expected):
    np.testing.assert_allclose(linear(unit, wanted), expected, rtol=1e-12)


@pytest.mark.parametrize(
    "unit", ["zorkmid", "m+", "9**9**9**9", "(((9**99)**99)**99)**99", "0", "-1", "1/0", "(", "x" * 99]
)
def test_an_unknown_unit_is_refused_by_name(unit):
    with pytest.raises(ReadingsError, match=r"the unit .* is not known"):
        linear(unit, "1")


@pytest.mark.parametrize(("unit", "wanted"), [("dBm", "W"), ("W", "dBm"), ("1e308*km", "m")])
def test_units_that_no_line_leads_from_one_to_the_other_are_refused(unit, wanted):
    with pytest.raises(ReadingsError, match=r"the unit .* is no linear function of"):
        linear(unit, wanted)


def test_a_unit_that_measures_something_else_is_refused_by_name():
    with pytest.raises(ReadingsError, match="the unit 'kg' cannot be converted into 'ppm'"):
        linear("kg", "ppm")
