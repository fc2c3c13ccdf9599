"""Right input, spoiled: bytes that are changed, documents of JSON with other values, and datasets of any layout.

All draws come from the generator that is passed, so a case can be made again from its number.
"""

from __future__ import annotations

import json
from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from random import Random
from typing import Any

WORDS = [
    *(b"time", b"value", b"lon", b"lat", b"x", b"y", b"entry", b"sd", b"unit", b"sensor", b"arrives", b"until", b"end"),
    *(b"nan", b"NaN", b"Infinity", b"-1e999", b"1e308", b"-0", b"1_0", b"0x1F", b"true", b"null", b"9" * 400),
    *(b"2026-11-30T12:00:00Z", b"0001-01-01", b"9999-12-31T23:59:59+23:59", b"12:00", b"mg m-3", b"m**9**9", b"ppm"),
    *(
        b'"',
        b'""',
        b"'",
        b",",
        b";",
        b"\t",
        b"\n",
        b"\r",
        b"\r\n",
        b"\x00",
        b"\xff\xfe",
        b"\xef\xbb\xbf",
        b"\xed\xa0\x80",
    ),
    *(b"{", b"}", b"[", b"]", b"[" * 5000, b":", b"\\", b"\\ud800", b"(", b")", b"#", b"=1+1", b" " * 300),
]
"""What files of readings and messages are made of, and what they must not be made of."""
ODD: list[Any] = [
    *(None, True, False, 0, -1, 0.5, 1e308, -1e308, 1e-320, float("nan"), float("inf"), 10**30, 10**400, 2**63),
    *("", " ", "nan", "1", "1e999", "Point", "Polygon", "time", "ppm", "m" * 70, "\x00", "\ud800", "2026-11-30", "１"),
    *([], {}, [[]], [None], [1, 2], ["a"], {"a": 1}, [[0, 0], [1, 1]], [[[8, 50], [8.001, 50], [8, 50.001], [8, 50]]]),
]
"""Values that stand where others should be."""


def spoiled(data: bytes, rng: Random) -> bytes:
    """Return bytes with some of them changed, left out, repeated, or with words between them."""
    found = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 3, 8))):
        start = rng.randrange(len(found) + 1)
        end = min(len(found), start + rng.choice((1, 1, 2, 8, 60, 1000)))
        kind = rng.randrange(7)
        if kind == 0 and start < len(found):
            found[start] = rng.randrange(256)
        elif kind == 1:
            del found[start:end]
        elif kind == 2:
            found[start:start] = found[start:end] * rng.choice((1, 2, 50))
        elif kind == 3:
            found[start:start] = rng.choice(WORDS)
        elif kind == 4:
            found[start:end] = rng.choice(WORDS)
        elif kind == 5:
            del found[start:]
        else:
            other = rng.randrange(len(found) + 1)
            found[start:end] = found[other : other + 40]
    return bytes(found)


def spoiled_json(document: Any, rng: Random) -> bytes:
    """Return a document of JSON in which some values, or some keys, are others."""
    found = json.loads(json.dumps(document))
    for _ in range(rng.choice((1, 1, 2, 5))):
        found = _replaced(found, rng)
    return json.dumps(found).encode()


def _replaced(value: Any, rng: Random) -> Any:
    """Return a value with one place in it, at any depth, changed."""
    if not isinstance(value, dict | list) or not value or rng.random() < 0.1:
        return deepcopy(rng.choice(ODD))
    if isinstance(value, list):
        at: Any = rng.randrange(len(value))
        if rng.random() < 0.1:
            value.insert(at, deepcopy(rng.choice(ODD)))
            return value
    else:
        at = rng.choice(list(value))
        if rng.random() < 0.1:
            value[rng.choice(WORDS).decode("utf-8", "replace")] = value.pop(at)
            return value
    value[at] = _replaced(value[at], rng)
    return value


NAMES = ["time", "value", "x", "y", "lon", "lat", "sd", "sensor", "unit", "entry", "arrives", "station", "index", "b"]
TYPES = ["f8", "f4", "i1", "i4", "i8", "u8", "S1", "str"]
ATTRIBUTES: dict[str, list[Any]] = {
    "units": ["s", "m", "ppm", "seconds since 2022-01-01", "days since never", "moons", 3.0, "", "s since 0000-00-00"],
    "standard_name": ["time", "longitude", "projection_x_coordinate", "a standard_error", 7, ""],
    "cf_role": ["timeseries_id", "trajectory_id", "?"],
    "instance_dimension": ["station", "obs", "nowhere", 1],
    "sample_dimension": ["obs", "station", "nowhere"],
    "missing_value": [0.0, "x", 99],
    "scale_factor": [0.0, 2.5, "two", 1e300],
    "add_offset": [1.0, "one", float("nan")],
    "coordinates": ["x y", "nothing at all", 5],
    "calendar": ["noleap", "360_day", "none", 4],
    "featureType": ["timeSeries", "trajectory", 5],
}
NUMBERS = [0.0, 1.0, 2.0, 3.5, -1.0, 1e300, float("nan"), float("inf"), 255.0, 1e9]


def dataset(path: Path, rng: Random) -> None:
    """Write a netCDF file with variables of any names, types, dimensions, attributes and values."""
    import netCDF4

    file = netCDF4.Dataset(path, "w", format=rng.choice(["NETCDF4", "NETCDF4", "NETCDF3_CLASSIC"]))
    sizes = {"obs": rng.choice((1, 3, 3, 3, 0)), "station": rng.choice((1, 2, 2, 3))}
    if rng.random() < 0.05 and file.data_model == "NETCDF4":
        sizes["obs"] = 2 * 10**9  # nothing is stored of it, but all would be read
    for name, size in sizes.items():
        file.createDimension(name, size)
    classic = file.data_model != "NETCDF4"
    drawn = rng.sample(NAMES, rng.randint(1, 8))
    for name in dict.fromkeys([*(("time", "value") if rng.random() < 0.8 else ()), *drawn]):
        kind = rng.choice(TYPES[:2] if rng.random() < 0.6 else TYPES)
        if classic and kind in ("i8", "u8", "str"):
            kind = "f8"
        dims = rng.choice((("obs",), ("obs",), ("obs",), ("station",), ("station", "obs"), (), ("obs", "station")))
        with suppress(RuntimeError):  # the older format has not all of it
            _variable(file, name, kind, dims, tuple(sizes[dim] for dim in dims), rng)
    file.close()


def _variable(file: Any, name: str, kind: str, dims: tuple[str, ...], shape: tuple[int, ...], rng: Random) -> None:
    """Add a variable with any attributes and values."""
    import numpy as np

    made = file.createVariable(name, str if kind == "str" else kind, dims)
    for key in rng.sample(list(ATTRIBUTES), rng.choice((0, 1, 1, 2))):
        made.setncattr(key, rng.choice(ATTRIBUTES[key]))
    if max(shape, default=0) > 10:
        return
    made.set_auto_maskandscale(False)
    drawn = [rng.choice(NUMBERS) for _ in range(int(np.prod(shape)))]
    if kind in ("str", "S1"):
        values: Any = np.array([f"{value:g}"[: 1 if kind == "S1" else 9] for value in drawn], dtype=object)
        values = values.astype("S1") if kind == "S1" else values
    else:
        wide = np.array(drawn) if kind[0] == "f" else np.nan_to_num(drawn, posinf=1.0).clip(0, 100)
        with np.errstate(over="ignore"):
            values = wide.astype(kind)
    made[...] = values.reshape(shape) if shape else values[0]
