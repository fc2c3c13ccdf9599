"""The readings of a run, as a table: so any run is an example of a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dafw.core.errors import ReadingsError
from dafw.core.runs import open_run
from dafw.core.space import Array
from dafw.plugins.readings.files.table import Table

EARLIER = 1e-6
"""Part of a cycle by which a reading must be older than it to count as late."""


def table_of_run(path: Path) -> tuple[Table, tuple[float, float] | None]:
    """Return the readings of a run in the order in which they became known, and the plane's origin if it has one.

    The origin is the longitude and latitude of (0, 0). A reading that became known in a later cycle than its own has
    the time ``arrives``. Raises RunError if there is no run, and ReadingsError if it has no readings, or readings
    without a place of which the file does not tell the entry.
    """
    with open_run(path) as run:
        name = run.encoding.get("source", str(path))
        known = run["time"].values
        value = run["observation_value"].values
        cycle, column = np.nonzero(np.isfinite(value))
        if not len(cycle):
            raise ReadingsError(f"run {name}: it has no readings")

        def of(variable: str) -> Any:
            return run[variable].values[cycle, column]

        time = of("observation_time")
        numbers: dict[str, Array] = {
            "time": time,
            "value": of("observation_value"),
            "sd": np.sqrt(of("observation_variance")),
        }
        if "observation_span" in run:
            numbers["span"] = np.nan_to_num(of("observation_span"))
        x, y, node = of("observation_x"), of("observation_y"), of("observation_node")
        if np.isfinite(x).all() and np.isfinite(y).all():
            numbers |= {"x": x, "y": y}
        elif np.isfinite(node).all() and (node >= 0).all():
            numbers["entry"] = node.astype(np.float64)
        else:
            raise ReadingsError(f"run {name}: it has readings that have neither a place nor an entry of their own")
        before = np.where(cycle > 0, known[cycle - 1], -np.inf)
        late = time <= before + EARLIER * (known[cycle] - before)
        if late.any():
            numbers["arrives"] = np.where(late, known[cycle], np.nan)
        units = run[f"{run.attrs['scored_variable']}_mean"].attrs.get("units", "1")
        texts = {"unit": np.full(len(time), units, dtype=object)}
        if "observation_sensor" in run:
            which = np.nan_to_num(of("observation_sensor"), nan=-1.0).astype(int)
            names = [str(one) for one in run["sensor_name"].values]
            texts["sensor"] = np.array([names[number] if number >= 0 else "" for number in which], dtype=object)
        place = [float(run.attrs[key]) for key in ("origin_longitude", "origin_latitude") if key in run.attrs]
    order: dict[str, Array] = {
        role: numbers[role] for role in ("time", "x", "y", "entry", "value", "sd", "span", "arrives") if role in numbers
    }
    origin = (place[0], place[1]) if len(place) == 2 else None
    return Table(str(name), "reading", np.arange(len(time)), order, texts), origin
