"""What a page shows of one run, as numbers and texts for its scripts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dafw.core.accessor.innovations import has_surprises, surprise
from dafw.views.contents import (
    buildings,
    has_map,
    is_positive,
    landmarks,
    scored_variable,
    stage,
    time_units,
    triangulation,
)
from dafw.views.places import has_places
from dafw.views.report_curves import curves_of, innovations_of, numbers, spoken, units_of
from dafw.views.report_fields import deflated_numbers, kept_rows, packed_fields
from dafw.views.report_forecasts import forecasts_of
from dafw.views.report_words import words_of
from dafw.views.style import peak_at_end

if TYPE_CHECKING:
    from xarray import Dataset

TITLES = {
    "truth": "Truth",
    "mean": "Belief",
    "smoothed_mean": "Belief",
    "free": "Free run",
    "spread": "Spread of the belief",
    "smoothed_spread": "Spread of the belief",
}
"""The titles of maps by the stage of a variable, in their order; revised beliefs take the place of those known then."""


def page_of_run(run: Dataset, folder: Path) -> dict[str, Any]:
    """Return everything that a page shows of a run, as opened by ``open_run``, whose other files are in ``folder``."""
    name = scored_variable(run)
    return {
        "kind": "run",
        "title": str(run.attrs.get("title") or run.attrs.get("name") or "run"),
        "name": str(run.attrs.get("name", "")),
        "seed": str(run.attrs.get("seed", "")),
        "time": {"values": numbers(run["time"].values), "units": time_units(run)},
        "variable": {
            "name": name.replace("_", " "),
            "title": spoken(name),
            "units": units_of(run, f"{name}_mean"),
        },
        "map": map_of(run),
        "fields": fields_of(run),
        "curves": curves_of(run),
        "innovations": innovations_of(run),
        "vehicles": _vehicles(run),
        "readings": readings_of(run),
        "sources": _sources(run),
        "wind": wind_of(run),
        "forecasts": forecasts_of(run, folder),
        "scores": _policy_scores(run),
        "words": words_of(run, folder),
    }


def map_of(run: Dataset) -> dict[str, Any] | None:
    """Return the plane with mesh, buildings and landmarks; None if nothing in this run has a place in the plane."""
    if has_map(run):
        mesh = triangulation(run)
        x, y = mesh.x, mesh.y
        found: dict[str, Any] = {
            "x": deflated_numbers(x, "<f4"),
            "y": deflated_numbers(y, "<f4"),
            "triangles": deflated_numbers(mesh.triangles, "<u4"),
        }
    else:
        x, y = _places(run)
        if x.size < 2:
            return None
        found = {"x": "", "y": "", "triangles": ""}
    margin = 0.0 if has_map(run) else 0.05 * max(float(np.ptp(x)), float(np.ptp(y)), 1.0)
    ends = [(values.min() - margin, values.max() + margin) for values in (x, y)]
    found["extent"] = [float(end) for pair in ends for end in pair]
    found["buildings"] = [numbers(points) for points in buildings(run)]
    found["landmarks"] = [{"name": text, "x": float(at[0]), "y": float(at[1])} for text, at in landmarks(run).items()]
    return found


def fields_of(run: Dataset) -> dict[str, Any] | None:
    """Return the scored variable at every stage, packed, with the scale of its colours; None if it is one number."""
    name = scored_variable(run)
    if run[f"{name}_mean"].ndim != 2:
        return None
    found = {key: values for key in TITLES if (values := stage(run, name, key)) is not None}
    recorded = np.flatnonzero(np.isfinite(found["mean"]).any(axis=1)) if "mean" in found else np.empty(0, dtype=int)
    if not recorded.size:
        return None
    found = {key: values[recorded] for key, values in found.items()}
    packed, every = packed_fields(found)
    reference = found.get("truth", found["mean"])
    least, most = float(np.nanmin(reference)), float(np.nanmax(reference))
    crosses = least < -0.25 * abs(most)
    peak = peak_at_end(np.abs(reference)) or 1.0
    return {
        "rows": recorded[kept_rows(len(recorded), every)].tolist(),
        "panels": [
            {"key": key, "title": TITLES[key], "peak": peak_at_end(values) or 1.0, **packed[key]}
            for key, values in found.items()
        ],
        # As in the pictures, from zero; a field with large negative values has zero in the middle.
        "bottom": -peak if crosses else 0.0,
        "top": peak,
        "logarithm": is_positive(run, name),
    }


def readings_of(run: Dataset) -> dict[str, Any]:
    """Return all readings as columns: row, place, value, what was expected, rank, and the surprise.

    The surprise is the innovation over the standard deviation that the forecast expects it to have. Files of an older
    dafw do not have the spread that this needs; then it is missing.
    """
    if "observation_value" not in run.variables:
        return {"row": []}
    value = run["observation_value"].values
    rows, columns = np.nonzero(np.isfinite(value))

    def column(name: str) -> np.ndarray:
        if name not in run.variables:
            return np.full(rows.size, np.nan)
        return np.asarray(run[name].values[rows, columns], dtype=np.float64)

    found = {
        "x": column("observation_x"),
        "y": column("observation_y"),
        "time": column("observation_time"),
        "value": value[rows, columns],
        "expected": column("observation_forecast_mean"),
        "surprise": surprise(run).values[rows, columns] if has_surprises(run) else np.full(rows.size, np.nan),
        "rank": column("observation_rank"),
    }
    return {"row": rows.tolist()} | {name: numbers(values) for name, values in found.items()}


def _vehicles(run: Dataset) -> list[dict[str, Any]]:
    """Return the path of every vehicle."""
    if "vehicle_x" not in run.variables or not run.sizes.get("vehicle"):
        return []
    pairs = zip(run["vehicle_x"].values.T, run["vehicle_y"].values.T, strict=True)
    return [{"x": numbers(x), "y": numbers(y)} for x, y in pairs]


def wind_of(run: Dataset) -> dict[str, Any] | None:
    """Return the wind's speed and direction (where it blows to, rad) by the stage of a map; None if it has no wind."""
    found: dict[str, Any] = {}
    speeds = []
    for key in ("truth", "mean", "free"):
        speed, direction = (stage(run, f"wind_{name}", key) for name in ("speed", "direction"))
        if speed is not None and direction is not None and speed.ndim == direction.ndim == 1:
            found[key] = {"speed": numbers(speed), "direction": numbers(direction)}
            speeds.append(np.nanmax(speed))
    fastest = float(max(speeds, default=0.0))
    return found | {"fastest": fastest} if fastest > 0.0 else None


def _sources(run: Dataset) -> dict[str, Any] | None:
    """Return every member's place of a source whose place is not known (rows, members)."""
    if not has_places(run):
        return None
    return {axis: numbers(run[f"release_{axis}_members"].values) for axis in "xy"}


def _policy_scores(run: Dataset) -> dict[str, Any] | None:
    """Return the scores of sectors or headings at every decision (rows, vehicles, directions)."""
    for kind in ("sector", "heading"):
        name = f"policy_{kind}_score"
        if name in run.variables and run[name].ndim == 3:
            return {"kind": kind, "values": [numbers(one) for one in run[name].values]}
    return None


def _places(run: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Return all places that a run without a mesh has: of vehicles, readings, landmarks and members' sources."""
    names = ["vehicle", "observation", "landmark", "obstacle"]
    pairs = [(f"{name}_x", f"{name}_y") for name in names]
    if has_places(run):
        pairs.append(("release_x_members", "release_y_members"))
    known = [pair for pair in pairs if set(pair) <= set(run.variables)]
    x, y = (np.concatenate([np.empty(0), *(np.ravel(run[pair[axis]].values) for pair in known)]) for axis in range(2))
    placed = np.isfinite(x) & np.isfinite(y)
    return x[placed], y[placed]
