"""Tables of readings for tests, and their comparison."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
from hypothesis import strategies as st

from dafw.plugins.readings.files.any_file import read_table, write_table
from dafw.plugins.readings.files.options import FileOptions
from dafw.plugins.readings.files.table import NUMBERS, Table

NUMBER = st.floats(-1e12, 1e12, allow_nan=False) | st.floats(allow_nan=False, allow_infinity=False)
NAME = st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=6)


@st.composite
def tables(draw):
    """Draw a table that a file can hold: with or without dates, places of every kind, missing numbers, sensors."""
    size = draw(st.integers(1, 5))

    def column(values):
        return np.array(draw(st.lists(values | st.just(np.nan), min_size=size, max_size=size)), dtype=float)

    dated = draw(st.booleans())
    span = st.integers(0, 10**12).map(lambda us: us / 1e6) if dated else NUMBER
    numbers = {"time": column(span), "value": column(NUMBER)}
    if dated:
        numbers["time"][0] = 0.0  # the epoch is the first time
    kind = draw(st.sampled_from(["metres", "degrees", "entry", None]))
    if kind == "metres":
        numbers |= {"x": column(NUMBER), "y": column(NUMBER)}
        if draw(st.booleans()):  # stations
            numbers |= {axis: np.full(size, draw(NUMBER)) for axis in "xy"}
    elif kind == "degrees":
        numbers |= {"lon": column(st.floats(-180, 180)), "lat": column(st.floats(-90, 90))}
        if np.isnan(numbers["lon"] + numbers["lat"]).any():  # GeoJSON has a whole point or none
            numbers["lon"][np.isnan(numbers["lat"])] = np.nan
            numbers["lat"][np.isnan(numbers["lon"])] = np.nan
        if np.isnan(numbers["lon"]).all():
            numbers["lon"][0] = numbers["lat"][0] = 1.0
    elif kind == "entry":
        numbers["entry"] = column(st.integers(0, 10**6).map(float))
    if draw(st.booleans()):
        numbers["sd"] = column(st.floats(1e-300, 1e300))
    if draw(st.booleans()):
        numbers["span"] = column(st.floats(0.0, 1e300))
    if draw(st.booleans()):
        numbers["arrives"] = np.where(draw(st.booleans()), numbers["time"], np.nan)
    texts = {}
    if draw(st.booleans()):
        units = st.sampled_from(["ppm", "mg m-3", "1"])
        texts["unit"] = np.array(draw(st.lists(units, min_size=size, max_size=size)), dtype=object)
    if draw(st.booleans()):
        texts["sensor"] = np.array(draw(st.lists(NAME, min_size=size, max_size=size)), dtype=object)
    epoch = datetime(2022, 12, 12, 10, 12, 40, 5, tzinfo=UTC) if dated else None
    return Table("drawn", "row", np.arange(size), {r: numbers[r] for r in NUMBERS if r in numbers}, texts, epoch)


def written_and_read(table, path, **options):
    """Return a table after writing it to a file and reading this."""
    path.unlink(missing_ok=True)
    write_table(table, path, (8.0, 50.0))
    return read_table(FileOptions(str(path), **options))


def require_same(one, other):
    """Fail unless two tables are the same to the last bit; a column without any entry may be absent."""
    assert len(one) == len(other) and one.epoch == other.epoch
    for role in NUMBERS:
        np.testing.assert_array_equal(one.number(role), other.number(role), role)
    for role in ("unit", "sensor"):
        assert one.text(role).tolist() == other.text(role).tolist()
