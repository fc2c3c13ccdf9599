"""The curves of a page: ERR, error and spread, every estimated number with its band, the gas, the innovations."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from dafw.core.domain import node_areas
from dafw.views.contents import (
    has_innovations,
    has_map,
    has_revised_errors,
    has_truth,
    is_angle,
    is_positive,
    scalar_variables,
    scored_variable,
    stage,
    triangulation,
)
from dafw.views.innovations import LATEST, recent
from dafw.views.series import unwrap_near

if TYPE_CHECKING:
    from xarray import Dataset

STAGES = {"truth": "truth", "mean": "belief", "free": "free run", "smoothed_mean": "as revised later"}
"""What the page calls the stages of a state variable, in the order in which they are drawn."""
REMARKS = {"wind_direction": "where it blows to, anticlockwise from the east"}
"""What a reader could take for something else: in weather reports a wind's direction is where it comes from."""
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def curves_of(run: Dataset) -> list[dict[str, Any]]:
    """Return every chart over time that the run has data for."""
    charts = [*_scores(run), *(_scalar(run, name) for name in scalar_variables(run))]
    if has_map(run):
        charts.append(_total(run))
    return charts


def innovations_of(run: Dataset) -> list[dict[str, Any]]:
    """Return the charts of the innovations over time; none without readings that were predicted."""
    if not has_innovations(run):
        return []
    charts = []
    for name, title, honest in (
        ("innovation_rms", "Innovations: root mean square", 1.0),
        ("innovation_mean", "Innovations: mean", 0.0),
    ):
        smooth = np.where(np.isfinite(run[name].values), recent(run, name), np.nan)
        charts.append(
            {
                "id": name,
                "title": title,
                "units": "",
                "lines": [
                    _line("mean", f"latest {LATEST} cycles with readings", smooth, joined=True),
                    _line("dots", "one cycle", run[name].values),
                ],
                "reference": {"value": honest, "label": "honest belief"},
                "log": honest > 0.0,
                "floor": 0.0 if honest > 0.0 else None,
            }
        )
    return charts


def plain_units(units: str) -> str:
    """Return units as a page shows them: ``m s⁻¹``; empty for a number without units."""
    if units in ("", "1"):
        return ""
    return re.sub(r"(?<=[A-Za-z])-?[0-9]+", lambda found: found[0].translate(RAISED), units)


def units_of(run: Dataset, name: str) -> str:
    """Return the units of a variable as a page shows them."""
    return plain_units(str(run[name].attrs.get("units", "")))


def numbers(values: np.ndarray) -> list[Any]:
    """Return numbers (n,) or (n, m) with six digits, as JSON takes them; None for what is not finite."""
    if values.ndim > 1:
        return [numbers(row) for row in values]
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in values.tolist()]


def _line(role: str, label: str, values: np.ndarray, *, joined: bool = False) -> dict[str, Any]:
    """Return a line of a chart; ``joined`` draws it across missing values."""
    return {"role": role, "label": label, "values": numbers(values), "joined": joined}


def _scores(run: Dataset) -> list[dict[str, Any]]:
    """Return ERR, and the belief's error beside its spread."""
    charts = []
    if has_truth(run):
        names = {"err": "mean", "err_free": "free", "err_smoothed": "smoothed_mean"}
        if not has_revised_errors(run):
            del names["err_smoothed"]
        lines = [_line(role, STAGES[role], run[name].values) for name, role in names.items() if name in run]
        charts.append(
            {
                "id": "err",
                "title": "ERR",
                "units": "%",
                "lines": [line for line in lines if any(value is not None for value in line["values"])],
                "reference": {"value": 100.0, "label": "empty map" if has_map(run) else "all zero"},
                "floor": 0.0,
                "log": True,
            }
        )
    scored = scored_variable(run)
    if run.sizes["time"] > 1 and "spread" in run:
        # Without a truth it is the spread alone.
        lines = [_line("mean", "spread", run["spread"].values)]
        if has_truth(run) and "rmse" in run:
            lines.append(_line("truth", "error", run["rmse"].values))
        charts.append(
            {
                "id": "rmse",
                "title": f"Root mean square {'error and spread' if len(lines) > 1 else 'spread'}",
                "units": "" if is_positive(run, scored) else units_of(run, f"{scored}_mean"),
                "lines": lines,
                "floor": 0.0,
                "log": True,
            }
        )
    return charts


def _scalar(run: Dataset, name: str) -> dict[str, Any]:
    """Return the chart of one number of the state; an angle is in degrees, without jumps."""
    spread = run[f"{name}_spread"].values
    found = {key: values for key in STAGES if (values := stage(run, name, key)) is not None}
    mean = found.get("mean", run[f"{name}_mean"].values)
    units = units_of(run, f"{name}_mean")
    if is_angle(run, name):
        start = found.get("truth", mean)[0]
        found = {key: np.degrees(unwrap_near(values, start)) for key, values in found.items()}
        mean, spread, units = found.get("mean", mean), np.degrees(spread), "°"
    low, high = mean - spread, mean + spread
    if is_positive(run, name):
        low, high = mean * np.exp(-spread), mean * np.exp(spread)
    return {
        "id": name,
        "title": spoken(name),
        "units": units,
        "remark": REMARKS.get(name, ""),
        "lines": [_line(key, STAGES[key], values) for key, values in found.items()],
        "bands": [{"low": numbers(low), "high": numbers(high), "label": "± spread"}],
        "log": is_positive(run, name),
    }


def _total(run: Dataset) -> dict[str, Any]:
    """Return the integral of the scored variable over the mesh; it is exact for a field that is linear in triangles."""
    scored, mesh = scored_variable(run), triangulation(run)
    weights = node_areas(np.column_stack([mesh.x, mesh.y]), mesh.triangles)
    units = str(run[f"{scored}_mean"].attrs.get("units", ""))
    lines = []
    for key, label in STAGES.items():
        if (values := stage(run, scored, key)) is not None:
            lines.append(_line(key, label, values.astype(np.float64) @ weights, joined=True))
    title = "Gas on the site" if scored == "concentration" else f"Integral of {scored.replace('_', ' ')}"
    return {
        "id": "total",
        "title": title,
        "units": plain_units(f"{units} m2" if units not in ("", "1") else "m2"),
        "lines": lines,
        "floor": 0.0,
        "log": True,
    }


def spoken(name: str) -> str:
    """Return a variable's name as the title of a chart."""
    spoken = name.replace("_", " ")
    return spoken[:1].upper() + spoken[1:]
