"""Reads from a run's Dataset what its variables are: their names, their kinds, their places."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray
from xarray import DataArray, Dataset

from dafw.core.errors import RunError
from dafw.core.space import Array, Kind, StateSpace, Variable

ESTIMATES = {"belief": "mean", "forecast": "forecast_mean", "smoothed": "smoothed_mean", "free": "free"}
"""The ending of a state variable's estimates in the file, by what they are called."""


def scored(run: Dataset) -> str:
    """Return the state variable that ERR is about; raises RunError if the Dataset is not that of a run."""
    name = run.attrs.get("scored_variable")
    if name is None:
        raise RunError("not a run of dafw, or a sweep over several models: the attribute 'scored_variable' is missing")
    return str(name)


def state_variables(run: Dataset) -> list[str]:
    """Return the names of the state variables in the order of the file."""
    names = [str(name).removesuffix("_mean") for name in run.data_vars if str(name).endswith("_mean")]
    return [name for name in names if f"{name}_spread" in run and not name.endswith(("_forecast", "_smoothed"))]


def state_variable(run: Dataset, name: str | None) -> str:
    """Return ``name``, or the scored variable for None; raises RunError if the run has no such state variable."""
    name = scored(run) if name is None else name
    if f"{name}_mean" not in run:
        raise RunError(f"no state variable '{name}' in this run (there are: {', '.join(state_variables(run))})")
    return name


def estimate(run: Dataset, name: str, of: str) -> DataArray:
    """Return an estimate of a state variable; raises RunError if there is none ``of`` that name, or it is missing."""
    if of not in ESTIMATES:
        raise RunError(f"of={of!r} is no estimate of '{name}' (expected one of: {', '.join(ESTIMATES)})")
    if f"{name}_{ESTIMATES[of]}" not in run:
        raise RunError(f"this run has no {name}_{ESTIMATES[of]}, which of='{of}' asks for")
    return run[f"{name}_{ESTIMATES[of]}"]


def node_dim(values: DataArray) -> str | None:
    """Return the dimension of the places of a field; None for a single number at each time."""
    return next((str(dim) for dim in values.dims if str(dim) == "node" or str(dim).startswith("node_")), None)


def space_of(run: Dataset, name: str) -> StateSpace:
    """Return the space of one state variable alone; the file's comment tells its kind."""
    mean = run[f"{name}_mean"]
    dim = node_dim(mean)
    said = re.match(r"\w+", str(mean.attrs.get("comment", "")))
    kinds = {kind.value: kind for kind in Kind}
    kind = kinds.get(said.group(), Kind.FIELD) if said else Kind.FIELD
    return StateSpace([Variable(name, 1 if dim is None else run.sizes[dim], kind)])


def field_of(run: Dataset, field: str | DataArray) -> DataArray:
    """Return a field by the name of a state variable (its mean) or of a variable of the file, or as it is given.

    Raises RunError if there is no such variable.
    """
    if isinstance(field, DataArray):
        return field
    for name in (field, f"{field}_mean"):
        if name in run.variables:
            return run[name]
    raise RunError(f"no variable '{field}' in this run (state variables: {', '.join(state_variables(run))})")


def nodes_of(run: Dataset, field: DataArray) -> Array:
    """Return the places (n, d) of a field's numbers in metres; raises RunError if it has none, or several."""
    dim = node_dim(field)
    if dim is None:
        raise RunError(f"{_said(field)} is a single number at each time: it has no places")
    columns = [run[f"{dim}_{axis}"] for axis in "xyz" if f"{dim}_{axis}" in run.variables]
    if not columns:
        raise RunError(f"{_said(field)} has no places: the run has no {dim}_x")
    if any(column.dims != (dim,) for column in columns):
        raise RunError(f"{_said(field)} has other places in one run than in another: choose one run of the sweep first")
    return np.column_stack([column.values for column in columns]).astype(np.float64)


def mesh_of(run: Dataset, field: DataArray) -> tuple[Array, NDArray[np.int32]]:
    """Return nodes (n, 2) and triangles (faces, 3) of the mesh of a field; raises RunError if it is on none.

    Runs on different meshes are padded in a sweep: padded triangles are left out, padded nodes moved onto a real one.
    """
    nodes = nodes_of(run, field)
    if "node" not in field.dims or "mesh2d_face_nodes" not in run.variables:
        raise RunError(f"{_said(field)} is not on a mesh of triangles, between whose nodes it would be linear")
    faces = run["mesh2d_face_nodes"]
    if faces.ndim != 2:
        raise RunError(f"{_said(field)} has another mesh in one run than in another: choose one run of the sweep first")
    triangles = faces.values[np.isfinite(faces.values).all(axis=1)].astype(np.int32)
    return np.where(np.isnan(nodes), nodes[triangles[0, 0]], nodes), triangles


def _said(field: DataArray) -> str:
    return f"'{field.name}'" if field.name else "the field"
