"""Reads from a run's dataset what the pictures need: state variables, mesh, buildings, landmarks, units."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.tri import Triangulation

from dafw.core.errors import RunError

if TYPE_CHECKING:
    from xarray import Dataset

RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
"""Superscripts as letters: matplotlib's formulas take a twentieth of the time that the pictures of a run take."""


def require(run: Dataset, purpose: str, *names: str) -> None:
    """Raise RunError if variables that ``purpose`` needs are missing."""
    missing = [name for name in names if name not in run.variables]
    if missing:
        raise RunError(f"{purpose} needs {', '.join(missing)}, which this run does not hold")


def scored_variable(run: Dataset) -> str:
    """Return the name of the first state variable, which ERR is about; raises RunError if it is not recorded."""
    name = run.attrs.get("scored_variable")
    if name is None:
        raise RunError("not a run of dafw: the global attribute 'scored_variable' is missing")
    require(run, "a picture of a run", "time", f"{name}_mean")
    return str(name)


def scalar_variables(run: Dataset) -> list[str]:
    """Return the state variables of one number each (estimated parameters, the wind), in the order of the file."""
    means = [str(name) for name, a in run.data_vars.items() if a.dims == ("time",) and str(name).endswith("_mean")]
    names = [name.removesuffix("_mean") for name in means]
    # The mean of the innovations has neither a forecast nor a spread.
    return [name for name in names if {f"{name}_mean", f"{name}_forecast_mean", f"{name}_spread"} <= set(run.data_vars)]


def has_map(run: Dataset) -> bool:
    """Return whether the scored variable is a field on a triangle mesh."""
    return (
        "mesh2d_face_nodes" in run and "node_x" in run.variables and "node" in run[f"{scored_variable(run)}_mean"].dims
    )


def has_truth(run: Dataset) -> bool:
    """Return whether there was a truth that the belief was compared with."""
    return _holds_numbers(run, "err")


def has_free_run(run: Dataset) -> bool:
    """Return whether a free run was computed beside the belief."""
    return _holds_numbers(run, f"{scored_variable(run)}_free")


def has_innovations(run: Dataset) -> bool:
    """Return whether there were readings that could be compared with the belief's predictions."""
    return _holds_numbers(run, "innovation_rms")


def _holds_numbers(run: Dataset, name: str) -> bool:
    """Return whether a variable exists and holds numbers; in a file it may be NaN everywhere."""
    return name in run.variables and bool(np.isfinite(run[name].values).any())


def stage(run: Dataset, variable: str, name: str) -> np.ndarray | None:
    """Return a state variable at a stage (``truth``, ``free``, ``smoothed_mean``); None if it is not recorded.

    A truth of another kind than the model may lack some of the model's variables: they hold NaN. A belief that was
    never revised is none that could be shown beside the belief.
    """
    full = f"{variable}_{name}"
    if not _holds_numbers(run, full):
        return None
    if name.startswith("smoothed_") and not _is_revised(run, full, f"{variable}_{name.removeprefix('smoothed_')}"):
        return None
    return np.asarray(run[full].values)


def has_revised_errors(run: Dataset) -> bool:
    """Return whether beliefs were revised later, and compared with a truth."""
    return _holds_numbers(run, "err_smoothed") and _is_revised(run, "err_smoothed", "err")


def _is_revised(run: Dataset, later: str, then: str) -> bool:
    """Return whether a variable as it was known later differs anywhere from what was known then."""
    return not np.array_equal(run[later].values, run[then].values, equal_nan=True)


def has_section(run: Dataset) -> bool:
    """Return whether the run has a polyline for the section, and more than one time."""
    return has_map(run) and "section_x" in run.variables and run.sizes["time"] > 1 and has_every_field(run)


def has_every_field(run: Dataset) -> bool:
    """Return whether the scored variable is recorded in every row; with ``record.fields=ends`` it is not."""
    mean = run[f"{scored_variable(run)}_mean"].values
    return bool(np.isfinite(mean).reshape(len(mean), -1).any(axis=1).all())


def triangulation(run: Dataset) -> Triangulation:
    """Return the mesh in metres."""
    require(run, "a map", "node_x", "node_y", "mesh2d_face_nodes")
    faces = run["mesh2d_face_nodes"].values.astype(int)
    return Triangulation(run["node_x"].values, run["node_y"].values, faces)


def buildings(run: Dataset) -> list[np.ndarray]:
    """Return the outline of each building, (corners, 2) in metres; the list may be empty."""
    if not run.sizes.get("obstacle"):
        return []
    ends = np.cumsum(run["obstacle_vertex_count"].values.astype(int))
    return np.split(polyline(run, "obstacle"), ends[:-1])


def polyline(run: Dataset, name: str) -> np.ndarray:
    """Return the points ``<name>_x, <name>_y`` as (points, 2) in metres."""
    return np.column_stack([run[f"{name}_x"].values, run[f"{name}_y"].values])


def landmarks(run: Dataset) -> dict[str, np.ndarray]:
    """Return the positions (2,) in metres of all landmarks of the site, by name."""
    if "landmark_name" not in run.variables:
        return {}
    names = [n.decode() if isinstance(n, bytes) else str(n) for n in run["landmark_name"].values]
    return dict(zip(names, polyline(run, "landmark"), strict=True))


def landmark(run: Dataset, name: str) -> np.ndarray | None:
    """Return the position (2,) in metres of a landmark of the site; None if there is none of that name."""
    return landmarks(run).get(name)


def is_angle(run: Dataset, variable: str) -> bool:
    """Return whether a state variable is an angle in radians, whose averages and differences wrap."""
    return run[f"{variable}_mean"].attrs.get("units") in ("rad", "radian", "radians")


def is_positive(run: Dataset, variable: str) -> bool:
    """Return whether a state variable is POSITIVE: its mean is geometric, its spread that of the logarithm."""
    return str(run[f"{variable}_mean"].attrs.get("comment", "")).startswith("positive")


def time_units(run: Dataset) -> str:
    """Return the unit of time; seconds if the file does not say."""
    return str(run["time"].attrs.get("units", "s"))


def label(run: Dataset, variable: str, units: str | None = None) -> str:
    """Return the axis label of a state variable: ``wind speed (m s⁻¹)``; no brackets if it is dimensionless."""
    units = str(run[f"{variable}_mean"].attrs.get("units", "")) if units is None else units
    spoken = variable.replace("_", " ")
    if units in ("", "1"):
        return spoken
    raised = re.sub(r"(?<=[A-Za-z])-?[0-9]+", lambda power: power.group().translate(RAISED), units)
    return f"{spoken} ({raised})"
