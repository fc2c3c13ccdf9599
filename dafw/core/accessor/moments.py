"""Mean, spread and quantiles of a belief, from its members where they were recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from xarray import DataArray, Dataset

from dafw.core.accessor.by_row import by_row
from dafw.core.accessor.contents import estimate, node_dim, space_of, state_variable
from dafw.core.ensemble import Ensemble
from dafw.core.errors import RunError
from dafw.core.space import Array


def mean(run: Dataset, name: str | None, of: str) -> DataArray:
    """Return the mean of a state variable: see ``RunAccessor.mean``."""
    name = state_variable(run, name)
    if of == "belief" and f"{name}_members" in run:
        return _titled(of_members(run, name, lambda ensemble: ensemble.mean), run[f"{name}_mean"])
    return estimate(run, name, of)


def spread(run: Dataset, name: str | None, of: str) -> DataArray:
    """Return the spread of a state variable: see ``RunAccessor.spread``."""
    name = state_variable(run, name)
    if of == "belief" and f"{name}_members" in run:
        return _titled(of_members(run, name, lambda ensemble: ensemble.spread), run[f"{name}_spread"])
    recorded = str(estimate(run, name, of).name).removesuffix("_mean") + "_spread"
    if recorded not in run:
        raise RunError(f"the free run is a single state: '{name}' has no spread of it")
    return run[recorded]


def quantile(run: Dataset, name: str | None, q: float | Sequence[float]) -> DataArray:
    """Return quantiles of a state variable: see ``RunAccessor.quantile``."""
    name = state_variable(run, name)
    several = np.atleast_1d(np.asarray(q, dtype=np.float64))
    if not ((several >= 0.0) & (several <= 1.0)).all():
        raise RunError(f"a quantile's q must be between 0 and 1, got {q}")
    require_members(run, name, "quantiles")

    def quantiles(ensemble: Ensemble) -> Array:
        return np.stack([ensemble.quantile(float(one)) for one in several])

    found = of_members(run, name, quantiles, {"quantile": len(several)}).assign_coords(quantile=several)
    found = found.transpose("quantile", ...) if np.ndim(q) else found.isel(quantile=0)
    return _titled(found, run[f"{name}_mean"]).rename(f"{name}_quantile")


def require_members(run: Dataset, name: str, purpose: str) -> None:
    """Raise RunError, which says how to record them, if the members of a state variable were not recorded."""
    if f"{name}_members" not in run:
        single = node_dim(run[f"{name}_mean"]) is None
        raise RunError(
            f"{purpose} of '{name}' need its members, which were not recorded: "
            f"run the study with record.members={'parameters' if single else 'all'}"
        )


def of_members(
    run: Dataset, name: str, function: Callable[[Ensemble], Any], before: dict[str, int] | None = None
) -> DataArray:
    """Return a function of the recorded ensembles of one state variable, row by row.

    It returns (..., n): axes with the names and sizes ``before``, then the nodes.
    """
    before = before or {}
    nodes = [dim for dim in [node_dim(run[f"{name}_members"])] if dim]

    def of_row(ensemble: Ensemble | None, *_: Array) -> Array:
        size = run.sizes[nodes[0]] if nodes else 1
        found = np.full((*before.values(), size), np.nan) if ensemble is None else np.asarray(function(ensemble))
        return found if nodes else found[..., 0]

    return with_members(run, name, of_row, [], [], [*before, *nodes], before)


def with_members(
    run: Dataset,
    name: str,
    function: Callable[..., Any],
    arrays: Sequence[DataArray],
    core: Sequence[Sequence[str]],
    result: Sequence[str],
    sizes: dict[str, int],
) -> DataArray:
    """Return ``function(ensemble, *rows)`` of the recorded ensembles of a state variable and of other arrays, by row.

    The ensemble is None where no member is recorded. Members that only other runs of a sweep have are left out.
    """
    members, space = run[f"{name}_members"], space_of(run, name)
    nodes = [dim for dim in [node_dim(members)] if dim]
    weighted = "weight" in run

    def of_row(values: Array, *rest: Array) -> Any:
        values = values if nodes else values[:, np.newaxis]
        weights, rows = (rest[0], rest[1:]) if weighted else (None, rest)
        there = ~np.isnan(values).all(axis=1)
        if not there.any():
            return function(None, *rows)
        if weights is not None:
            weights = None if np.isnan(weights[there]).all() else weights[there]
        return function(Ensemble(values[there], space, weights=weights), *rows)

    given = [members, *([run["weight"]] if weighted else []), *arrays]
    dims = [["member", *nodes], *([["member"]] if weighted else []), *core]
    return by_row(of_row, given, dims, result, sizes)


def _titled(values: DataArray, like: DataArray) -> DataArray:
    return values.rename(like.name).assign_attrs(like.attrs)
