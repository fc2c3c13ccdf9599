"""Broken files of readings: each ends in one clear line that names the file and, where there is one, row and column."""

from __future__ import annotations

import json

import netCDF4
import numpy as np
import pytest
import xarray

from dafw.commands import main

HEAD = "time,x,y,value,unit,sd\n"
GOOD = HEAD + "1,0,0,5,1,0.1\n"
CSV = {
    "empty": ("", "is empty, expected a line of column names"),
    "blank lines only": ("\n\n  \n", "is empty, expected a line of column names"),
    "no time": ("t,x,y,value\n1,0,0,5\n", "no column 'time' (there are: t, x, y, value), say which with columns.time"),
    "five hundred columns": (",".join(f"c{n}" for n in range(500)) + "\n", "c18, c19 and 480 more), say which"),
    "no value": ("time,x,y\n1,0,0\n", "no column 'value'"),
    "two values": ("time,value,value\n1,0,0\n", "2 columns are called 'value', expected one"),
    "y missing": ("time,x,value\n1,0,5\n", "no column 'y' beside 'x'"),
    "lat missing": ("time,lon,value\n1,0,5\n", "no column 'lat' beside 'lon'"),
    "a word for a value": (GOOD + "2,0,0,low,1,0.1\n", "line 3, column 'value': expected a number, got 'low'"),
    "infinite": (GOOD + "2,0,0,1e999,1,0.1\n", "line 3, column 'value': expected a finite number, got '1e999'"),
    "a word for a place": (GOOD + "2,here,0,1,1,0.1\n", "line 3, column 'x': expected a number, got 'here'"),
    "underscores": (GOOD + "2,1_000,0,1,1,0.1\n", "line 3, column 'x': expected a number, got '1_000'"),
    "a date among seconds": (GOOD + "2022-12-12,0,0,1,1,0.1\n", "line 3, column 'time': expected a number"),
    "seconds among dates": (
        "time,value\n2022-12-12T10:00:00Z,1\n60,2\n",
        "line 3, column 'time': expected a time as seconds or a date in ISO 8601 (time_format says another), got '60'",
    ),
    "no date": ("time,value\nyesterday,1\n", "line 2, column 'time': expected a time as seconds or a date"),
    "a 13th month": ("time,value\n2022-13-12T10:00:00Z,1\n", "line 2, column 'time': expected a time"),
    "sd of zero": (HEAD + "1,0,0,5,1,0\n", "line 2, column 'sd': expected a standard deviation above 0, got 0"),
    "a negative sd": (HEAD + "1,0,0,5,1,-1\n", "line 2, column 'sd': expected a standard deviation above 0, got -1"),
    "an unknown unit": (GOOD + "2,0,0,1,smoots,0.1\n", "line 3, column 'value': the unit 'smoots' is not known"),
    "an unknown unit above": ("time,value (zork)\n1,2\n", "column 'value (zork)': the unit 'zork' is not known"),
    "a unit of time that is none": (
        "time (moons),value\n1,2\n",
        "column 'time (moons)': the unit 'moons' is not known",
    ),
    "a length as time": ("time (m),value\n1,2\n", "column 'time (m)': the unit 'm' cannot be converted into 's'"),
    "sd in another unit": ("time,value (ppm),sd (ppb)\n1,2,3\n", "the sd is in 'ppb', the value in 'ppm'"),
    "a cell too many": (GOOD + "2,0,0,1,1,0.1,9\n", "line 3: 7 cells, but there are 6 columns"),
    "a cell too few": (GOOD + "2,0,0,1\n", "line 3: 4 cells, expected 6, one for each column"),
    "an open quote": (GOOD + '2,0,0,"1,1,0.1\n', "line 3: is not CSV (unexpected end of data)"),
    "not text": (b"time,value\n1,\xff\xfe\n", "line 2: expected text in UTF-8, got something else"),
    "latitude of 95": (
        "time,lon,lat,value\n1,8,95,5\n",
        "line 2, column 'lat': expected degrees from -90 to 90, got 95",
    ),
    "longitude of 400": ("time,lon,lat,value\n1,400,5,5\n", "line 2, column 'lon': expected degrees from -180 to 360"),
    "half an entry": ("time,entry,value\n1,0.5,5\n", "line 2, column 'entry': expected a whole number from 0, got 0.5"),
    "known too early": (
        "time,arrives,value\n2,1,5\n",
        "line 2, column 'arrives': a reading cannot arrive before it is taken, got 1",
    ),
    "a span below 0": ("time,value,span\n2,1,-5\n", "line 2, column 'span': expected a time from 0, got -5"),
    "a bell in a name": (
        "time,value,sensor\n2,1,a\x07b\n",
        "line 2, column 'sensor': expected a text that can be printed",
    ),
}


def feature(**properties):
    return {"type": "Feature", "geometry": {"type": "Point", "coordinates": [8, 50]}, "properties": properties}


def collection(*features, **more):
    return json.dumps({"type": "FeatureCollection", "features": list(features), **more})


RIGHT = feature(time=1, value=2)
GEOJSON = {
    "empty": ("", "is not JSON, or cut off"),
    "cut off": (collection(RIGHT)[:40], "line 1: is not JSON, or cut off"),
    "not text": (b'{"type": "\xff"}', "expected GeoJSON in UTF-8"),
    "too deep": ("[" * 100_000, "is nested too deeply for GeoJSON"),
    "a list": ("[1, 2]", "expected a GeoJSON FeatureCollection, got a list"),
    "a geometry": (
        '{"type": "Point", "coordinates": [8, 50]}',
        "expected a GeoJSON FeatureCollection, got the type 'Point'",
    ),
    "no features": ('{"type": "FeatureCollection"}', "expected a list 'features', got None"),
    "another system": (
        collection(RIGHT, crs={"name": "EPSG:25832"}),
        "expected longitude and latitude in the reference",
    ),
    "no feature": (collection(RIGHT, 7), "feature 2: expected an object of the type Feature, got 7"),
    "no properties": (collection(RIGHT, {"type": "Feature"}), "feature 2: expected properties with time and value"),
    "no time": (collection(feature(value=1)), "no column 'time'"),
    "a line": (
        collection({"type": "Feature", "geometry": {"type": "LineString"}, "properties": {}}),
        "feature 1: expected a Point, got 'LineString'",
    ),
    "half a point": (
        collection({**RIGHT, "geometry": {"type": "Point", "coordinates": [8]}}),
        "feature 1: expected coordinates [longitude, latitude], got [8]",
    ),
    "words for a point": (
        collection({**RIGHT, "geometry": {"type": "Point", "coordinates": ["8", "50"]}}),
        "feature 1: expected coordinates in degrees, got ['8', '50']",
    ),
    "true for a value": (
        collection(RIGHT, feature(time=1, value=True)),
        "feature 2, column 'value': expected a number, got True",
    ),
    "an object": (collection(feature(time=1, value={"a": 1})), "feature 1, column 'value': expected a number"),
    "a huge number": (
        '{"type": "Feature", "properties": {"time": 1, "value": 1' + "0" * 400 + "}}",
        "feature 1, column 'value': expected a finite number",
    ),
    "a number of ten thousand digits": ("1" * 10_000, "holds a number that cannot be read"),
    "a list for a sensor": (
        collection(feature(time=1, value=1, sensor=[1])),
        "feature 1, column 'sensor': expected a text",
    ),
}


def series(**changes):
    """Return a right dataset of three readings, with some variables changed."""
    variables = {
        "time": ("obs", [1.0, 2.0, 3.0], {"units": "s"}),
        "value": ("obs", [1.0, 2.0, 3.0], {"units": "ppm"}),
        "x": ("station", [0.0, 1.0], {"units": "m"}),
        "y": ("station", [0.0, 1.0], {"units": "m"}),
        "index": ("obs", np.array([0, 1, 1], dtype="i4"), {"instance_dimension": "station"}),
    }
    return xarray.Dataset({name: value for name, value in {**variables, **changes}.items() if value is not None})


NETCDF = {
    "no netCDF": (b"time,value\n1,2\n", "cannot be read as netCDF"),
    "cut off": (None, "cannot be read as netCDF"),
    "no time": (series(time=None), "no column 'time' (there are: value, x, y, index)"),
    "several values": (
        series(value=None, a=("obs", [1.0, 2.0, 3.0]), b=("obs", [1.0, 2.0, 3.0])),
        "several variables may be the value: a, b; say which with columns.value",
    ),
    "one number": (series(value=((), 1.0)), "column 'value': expected one or two dimensions, got 0"),
    "three dimensions": (
        series(value=(("obs", "a", "b"), np.ones((3, 1, 1)))),
        "expected one or two dimensions, got 3",
    ),
    "foreign dimensions": (series(index=None), "column 'x': its dimensions ('station',) do not fit those of the value"),
    "a station too many": (
        series(index=("obs", np.array([0, 1, 2], dtype="i4"), {"instance_dimension": "station"})),
        "column 'index': expected numbers below 2, got 2",
    ),
    "a negative station": (
        series(index=("obs", np.array([0, 1, -1], dtype="i4"), {"instance_dimension": "station"})),
        "column 'index': expected whole numbers from 0",
    ),
    "rows that do not add up": (
        series(index=("station", np.array([1, 1], dtype="i4"), {"sample_dimension": "obs"})),
        "column 'index': its sum is 2, but there are 3 readings",
    ),
    "a huge station": (
        series(index=("obs", np.array([0, 1e300, 1]), {"instance_dimension": "station"})),
        "column 'index': expected whole numbers from 0",
    ),
    "half a station": (
        series(index=("obs", np.array([0, 0.5, 1]), {"instance_dimension": "station"})),
        "column 'index': expected whole numbers from 0",
    ),
    "an unknown unit": (
        series(value=("obs", [1.0, 2, 3], {"units": "zork"})),
        "column 'value': the unit 'zork' is not known",
    ),
    "profiles": (
        series().assign_attrs(featureType="profile"),
        "expected the featureType timeSeries, trajectory or point, got 'profile'",
    ),
    "since never": (
        series(time=("obs", [1.0, 2, 3], {"units": "seconds since never"})),
        "column 'time': expected units 'seconds since' a date in ISO 8601, got 'seconds since never'",
    ),
    "moons since": (
        series(time=("obs", [1.0, 2, 3], {"units": "moons since 2022-01-01"})),
        "column 'time': the unit 'moons' is not known",
    ),
    "texts since": (
        series(time=("obs", ["a", "b", "c"], {"units": "s since 2022-01-01"})),
        "column 'time': expected numbers, as its units say, got 'a'",
    ),
    "the end of time": (
        series(time=("obs", [1.0, 2, 1e300], {"units": "days since 2022-01-01"})),
        "is a year that dates do not have",
    ),
    "infinite": (series(value=("obs", [1.0, np.inf, 3])), "row 1, column 'value': expected a finite number, got inf"),
    "a negative sd": (
        series(sd=("obs", [1.0, 1.0, -1.0])),
        "row 2, column 'sd': expected a standard deviation above 0, got -1",
    ),
}


def refused(path, capsys):
    """Return the one line with which the command refuses a file."""
    assert main(["readings", str(path)]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith(f"dafw: readings file {path}")
    return err


def test_these_are_more_than_thirty():
    assert len(CSV) + len(GEOJSON) + len(NETCDF) > 60


@pytest.mark.parametrize("kind", CSV)
def test_broken_csv(kind, tmp_path, capsys):
    content, said = CSV[kind]
    path = tmp_path / "a.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert said in refused(path, capsys)


@pytest.mark.parametrize("kind", GEOJSON)
def test_broken_geojson(kind, tmp_path, capsys):
    content, said = GEOJSON[kind]
    path = tmp_path / "a.geojson"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert said in refused(path, capsys)


@pytest.mark.parametrize("kind", NETCDF)
def test_broken_netcdf(kind, tmp_path, capsys):
    content, said = NETCDF[kind]
    path = tmp_path / "a.nc"
    if isinstance(content, xarray.Dataset):
        content.to_netcdf(path, engine="netcdf4")
    else:
        series().to_netcdf(path, engine="netcdf4")
        path.write_bytes(content or path.read_bytes()[:1000])
    assert said in refused(path, capsys)


def test_a_small_file_that_declares_billions_of_readings(tmp_path, capsys):
    with netCDF4.Dataset(tmp_path / "a.nc", "w") as file:
        file.createDimension("obs", 2_000_000_000)
        for name in ("time", "value"):
            file.createVariable(name, "f8", ("obs",))
    assert (tmp_path / "a.nc").stat().st_size < 100_000
    assert "would take 32.0 GB of memory, at most 2 GB are read" in refused(tmp_path / "a.nc", capsys)


@pytest.mark.parametrize("content", [GOOD, "time,value\n1,2\n"])
def test_what_is_right_is_not_refused(content, tmp_path, capsys):
    (tmp_path / "a.csv").write_text(content)
    (tmp_path / "a.geojson").write_text(collection(RIGHT))
    series().to_netcdf(tmp_path / "a.nc", engine="netcdf4")
    for name in ("a.csv", "a.geojson", "a.nc"):
        assert main(["readings", str(tmp_path / name)]) == 0
        assert "rows" in capsys.readouterr().out or name != "a.nc"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere.csv"], "readings file nowhere.csv: not found"),
        (["nowhere.xls"], "readings file nowhere.xls: not found"),
        (["a\0b.csv"], "not found"),
        ([], "the following arguments are required: file"),
        (["example", "colour=red"], "unknown option 'colour'"),
        (["example", "red"], "expected an option NAME=VALUE, got 'red'"),
        (["example", "sd=1,2"], "expected an option NAME=VALUE, got 'sd=1,2'"),
        (["example", "file=b.csv"], "the file is 'example', it cannot be an option, too"),
        (["example", "sd=-1"], "option 'sd' must be above 0"),
        (["example", "columns.value=CO2"], "no column 'CO2'"),
        (["example", "place=entry"], "no column 'entry'"),
        (["example", "unit=zork"], "the unit 'zork' is not known"),
        (["example", "origin=[8]"], "origin must be [longitude, latitude] in degrees"),
        (["example", "sensors={a: 1}"], "expected a mapping of options, got 1"),
        (["example", "sensors={a: {colour: 1}}"], "sensor 'a': unknown option 'colour'"),
        (["example", "--to", "a.xls"], "expected a name that ends in"),
        (["."], "holds no run"),
    ],
)
def test_nonsense_ends_with_status_2_and_one_line(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["readings", *words]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and said in err
