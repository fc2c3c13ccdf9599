"""Readings in netCDF, as CF discrete sampling geometries: ``timeSeries`` (stations) or ``trajectory`` (vehicles).

Read are single features, arrays with a dimension of instances, and contiguous and indexed ragged arrays (CF-1.11,
appendix H). Written are indexed ragged arrays, which keep the order of the readings.
"""

from __future__ import annotations

import re
from datetime import UTC
from pathlib import Path
from typing import Any

import numpy as np

from dafw.core.errors import ReadingsError
from dafw.plugins.readings.files.cells import Raw, find_columns, made
from dafw.plugins.readings.files.options import FileOptions
from dafw.plugins.readings.files.table import Table, about, shown, written_date
from dafw.plugins.readings.files.times import parsed_date
from dafw.plugins.readings.files.units import linear

SINCE = re.compile(r"^\s*(\S+)\s+since\s+(.+?)\s*$", re.IGNORECASE)
STANDARD_NAMES = {
    "time": "time",
    "lon": "longitude",
    "lat": "latitude",
    "x": "projection_x_coordinate",
    "y": "projection_y_coordinate",
}
LARGEST = 2_000_000_000
"""Bytes that the variables of a file may have."""
FEATURES = ("timeseries", "trajectory", "point")
"""Kinds of features that are read, in small letters as CF compares them; a file need not name its kind."""
EXACT = 2**53
"""Up to here every whole number is a floating-point number."""
IDS = ("timeseries_id", "trajectory_id")
STRUCTURE = ("instance_dimension", "sample_dimension")
"""Attributes of variables that say which reading belongs to which instance."""


def read_netcdf(path: Path, options: FileOptions) -> Table:
    """Return the readings of a file; raises ReadingsError, which names the row (from 0) and the variable."""
    import xarray

    name = str(path)
    try:
        with xarray.open_dataset(path, engine="netcdf4", decode_times=False, decode_coords=False) as opened:
            if opened.nbytes > LARGEST:  # a few bytes can declare a dimension of billions
                text = f"would take {opened.nbytes / 1e9:.1f} GB of memory, at most {LARGEST / 1e9:g} GB are read"
                raise about(name, text)
            dataset = opened.load()
    except ReadingsError:
        raise
    except Exception as error:  # netCDF4, HDF5 and xarray raise errors of many kinds for what is not netCDF
        raise about(name, f"cannot be read as netCDF ({' '.join(str(error).split())[:120]})") from None
    return _table(dataset.reset_coords(), name, options)


def _table(dataset: Any, name: str, options: FileOptions) -> Table:
    kind = str(dataset.attrs.get("featureType", FEATURES[0]))
    if kind.lower() not in FEATURES:
        raise about(name, f"expected the featureType timeSeries, trajectory or point, got {shown(kind)}")
    headers = _headers(dataset, options, name)
    sought = list(headers)
    found = {role: headers[sought[n]] for role, n in find_columns(sought, options.columns, name).items()}
    values = dataset[found["value"]]
    if values.ndim not in (1, 2):
        raise about(name, f"expected one or two dimensions, got {values.ndim}", column=found["value"])
    cells: dict[str, Any] = {}
    units: dict[str, str] = {}
    for role, variable in found.items():
        cells[role] = _aligned(dataset, variable, values, name)
        if "units" in dataset[variable].attrs and role not in ("lon", "lat", "entry", "unit", "sensor"):
            units[role] = str(dataset[variable].attrs["units"]).strip()
    if values.ndim == 2:  # shorter features are padded with missing times and values
        there = ~(_is_nan(cells["value"]) & _is_nan(cells["time"]))
    else:
        there = np.ones(values.size, dtype=bool)
    rows = np.flatnonzero(there)
    raw_cells = {role: [_plain(cell) for cell in column[there]] for role, column in cells.items()}
    for role in ("time", "arrives"):
        if since := SINCE.match(units.get(role, "")):
            units.pop(role)
            raw_cells[role] = _dated(raw_cells[role], since, name, found[role])
    others = tuple(str(one) for one in dataset.variables if one not in found.values())
    return made(Raw(name, "row", rows.tolist(), raw_cells, found, units, others), options)


def _headers(dataset: Any, options: FileOptions, name: str) -> dict[str, str]:
    """Return the variables by the names under which they are looked for.

    CF names the variables by their attributes: such a variable is also found under the name of its role.
    """
    headers = {str(one): str(one) for one in dataset.variables}
    for one, variable in dataset.variables.items():
        standard, role = variable.attrs.get("standard_name", ""), None
        for candidate, expected in STANDARD_NAMES.items():
            role = candidate if standard == expected else role
        role = "sensor" if variable.attrs.get("cf_role") in IDS else role
        role = "sd" if str(standard).endswith(" standard_error") else role
        if role is not None:
            headers.setdefault(role, str(one))
    if options.columns.value is None and "value" not in headers:
        roles = (*STANDARD_NAMES, "sensor", "sd", "span", "arrives", "entry")
        taken = set(headers[role] for role in headers if role in roles)
        likely = [
            str(one)
            for one, variable in dataset.variables.items()
            if variable.dtype.kind in "fiu"
            and 1 <= variable.ndim <= 2
            and str(one) not in taken
            and not any(key in variable.attrs for key in STRUCTURE)
        ]
        if len(likely) > 1:
            raise about(name, f"several variables may be the value: {', '.join(likely)}; say which with columns.value")
        if likely:
            headers["value"] = likely[0]
    return headers


def _aligned(dataset: Any, variable: str, values: Any, name: str) -> Any:
    """Return a variable for every reading, flat: repeated over the readings of its instance where it has one each."""
    array = dataset[variable]
    if set(array.dims) <= set(values.dims):
        return np.asarray(array.broadcast_like(values).transpose(*values.dims)).ravel()
    if array.ndim == 1 and values.ndim == 1:
        owners = _owners(dataset, array.dims[0], values, name)
        if owners is not None:
            return np.asarray(array)[owners]
    raise about(name, f"its dimensions {array.dims} do not fit those of the value {values.dims}", column=variable)


def _owners(dataset: Any, instances: Any, values: Any, name: str) -> Any:
    """Return the number of the instance that each reading of a ragged array belongs to; None if nothing tells it."""
    for one, variable in dataset.variables.items():
        attributes = variable.attrs
        indexed = attributes.get("instance_dimension") == instances and variable.dims == values.dims
        counted = attributes.get("sample_dimension") == values.dims[0] and variable.dims == (instances,)
        if not indexed and not counted:
            continue
        numbers = np.asarray(variable)
        count = dataset.sizes[instances]
        possible = numbers.dtype.kind in "iuf" and ((numbers >= 0) & (numbers <= EXACT)).all()
        if not possible or (numbers % 1 != 0).any():
            raise about(name, "expected whole numbers from 0", column=str(one))
        numbers = numbers.astype(np.int64)
        if indexed and (numbers >= count).any():
            raise about(name, f"expected numbers below {count}, got {numbers.max()}", column=str(one))
        if counted and numbers.sum() != values.size:
            raise about(name, f"its sum is {numbers.sum()}, but there are {values.size} readings", column=str(one))
        return numbers if indexed else np.repeat(np.arange(count), numbers)
    return None


def _is_nan(column: Any) -> Any:
    return np.isnan(column) if column.dtype.kind == "f" else np.zeros(len(column), dtype=bool)


def _plain(cell: Any) -> Any:
    """Return a cell as one of Python's own values."""
    return cell.item() if hasattr(cell, "item") else cell


def _dated(cells: list[Any], since: re.Match[str], name: str, variable: str) -> list[str]:
    """Return times "UNIT since DATE" as dates in ISO 8601, "" where they are missing."""
    epoch = parsed_date(since[2].removesuffix("UTC").strip(), None)
    if epoch is None:
        raise about(name, f"expected units 'seconds since' a date in ISO 8601, got '{since[0]}'", column=variable)
    try:
        shift, factor = linear(since[1], "s")
    except ReadingsError as error:
        raise about(name, str(error), column=variable) from None
    written = []
    for cell in cells:
        if not isinstance(cell, int | float):
            raise about(name, f"expected numbers, as its units say, got {cell!r}", column=variable)
        seconds = shift + factor * cell
        if np.isinf(seconds) or abs(seconds) > 1e11:
            raise about(name, f"{cell!r} {since[0]} is a year that dates do not have", column=variable)
        written.append("" if np.isnan(seconds) else written_date(epoch, seconds))
    return written


def write_netcdf(table: Table, path: Path) -> None:
    """Write a table; reading the file gives the same numbers, to the last bit."""
    import xarray

    sensors = list(dict.fromkeys(table.text("sensor"))) or [""]
    owners = np.array([sensors.index(sensor) for sensor in table.text("sensor")], dtype="i4")
    kind = table.place_kind()
    fixed = kind in ("metres", "degrees") and _are_fixed(table, owners, kind)
    feature = "timeseries" if fixed else "trajectory"
    instance = "station" if fixed else "trajectory"
    dataset = xarray.Dataset(attrs={"Conventions": "CF-1.11", "title": "readings"})
    if kind in ("metres", "degrees"):
        dataset.attrs["featureType"] = "timeSeries" if fixed else "trajectory"
    dataset["sensor"] = (
        (instance,),
        np.array(sensors, dtype=object),
        {"cf_role": f"{feature}_id", "long_name": "name of the sensor"},
    )
    dataset["sensor_index"] = (("obs",), owners, {"instance_dimension": instance, "long_name": "sensor of the reading"})
    units = list(dict.fromkeys(table.text("unit")))
    for role, column in table.numbers.items():
        attributes, dims, values = _attributes(table, role), ("obs",), column
        if fixed and role in ("x", "y", "lon", "lat"):
            dims, values = (instance,), column[[int(np.argmax(owners == n)) for n in range(len(sensors))]]
        if role in ("value", "sd") and len(units) == 1 and units[0]:
            attributes["units"] = units[0]
        dataset[role] = (dims, values, attributes)
    if len(units) > 1:
        dataset["unit"] = (("obs",), table.text("unit"), {"long_name": "unit of the value"})
    there = [role for role in ("time", "x", "y", "lon", "lat") if role in table.numbers]
    dataset["value"].attrs["coordinates"] = " ".join(there)
    if "sd" in table.numbers:
        dataset["value"].attrs["ancillary_variables"] = "sd"
    texts = [one for one in dataset.variables if dataset[one].dtype == object]
    dataset.to_netcdf(path, engine="netcdf4", encoding={one: {"dtype": str} for one in texts})


def _are_fixed(table: Table, owners: Any, kind: str) -> bool:
    """Return whether no sensor moves."""
    roles = ("x", "y") if kind == "metres" else ("lon", "lat")
    others = [role for role in ("x", "y", "lon", "lat") if role in table.numbers and role not in roles]
    for role in (*roles, *others):
        first = {int(owner): table.numbers[role][int(np.argmax(owners == owner))] for owner in np.unique(owners)}
        held = np.array([first[int(owner)] for owner in owners])
        if not np.array_equal(held, table.numbers[role], equal_nan=True) or np.isnan(held).any():
            return False
    return len(owners) > 0


def _attributes(table: Table, role: str) -> dict[str, str]:
    """Return the attributes of a column."""
    if role in ("time", "arrives"):
        date = None if table.epoch is None else written_date(table.epoch.astimezone(UTC), 0.0)
        dated = {"calendar": "standard", "units_metadata": "leap_seconds: none"}
        said = {"units": "s"} if date is None else {"units": f"seconds since {date}", **dated}
        name = "time" if role == "time" else "time at which the reading became known"
        return said | {"long_name": name} | ({"standard_name": "time", "axis": "T"} if date and role == "time" else {})
    named = {"standard_name": STANDARD_NAMES[role]} if role in STANDARD_NAMES else {}
    units = {"x": "m", "y": "m", "span": "s", "lon": "degrees_east", "lat": "degrees_north", "entry": "1"}
    long_names = {
        "value": "reading",
        "sd": "standard deviation of the reading's error",
        "span": "time over which the reading is a mean, until its time",
        "entry": "entry of the state",
    }
    return (
        named
        | ({"units": units[role]} if role in units else {})
        | ({"long_name": long_names[role]} if role in long_names else {})
    )
