"""Errors of a run against its truth, by time: ERR, root mean square, and the score of the whole ensemble (CRPS).

The CRPS of members x_i with weights w_i against a truth y is

    sum_i w_i d(x_i, y) - 1/2 sum_ij w_i w_j d(x_i, x_j)

with the distance d = |x - y|; for angles the shorter way round (Grimit et al. 2006, doi:10.1256/qj.05.235), for
positive variables |log x - log y|, as in their root mean square. ERR compares positive numbers as they are.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from xarray import DataArray, Dataset

from dafw.core.accessor.by_row import by_row
from dafw.core.accessor.contents import estimate, node_dim, scored, space_of, state_variable
from dafw.core.accessor.moments import require_members, with_members
from dafw.core.diagnostics import error_of, root_mean_square
from dafw.core.ensemble import Ensemble
from dafw.core.errors import RunError
from dafw.core.space import Array, Kind

RECORDED = {"belief": "err", "forecast": "err_forecast", "free": "err_free", "smoothed": "err_smoothed"}
"""The variable of the file that holds ERR of the scored variable, by what is compared."""


def err(run: Dataset, name: str | None, of: str) -> DataArray:
    """Return ERR in per cent: see ``RunAccessor.err``."""
    name = state_variable(run, name)
    truth_of(run, name)
    estimate(run, name, of)
    if name == scored(run) and RECORDED[of] in run:
        return run[RECORDED[of]]
    found = error_by_row(run, name, of, lambda space, truth, guess: error_of(space, truth, guess))
    return found.rename(f"{name}_err").assign_attrs(
        units="percent", long_name=f"relative l2 difference of {name} ({of}) from the truth"
    )


def rmse(run: Dataset, name: str | None, of: str) -> DataArray:
    """Return the root mean square error: see ``RunAccessor.rmse``."""
    name = state_variable(run, name)
    found = error_by_row(run, name, of, lambda space, truth, guess: root_mean_square(space.difference(truth, guess)))
    return found.rename(f"{name}_rmse").assign_attrs(
        units=_error_units(run, name), long_name=f"root mean square of {name} ({of}) less the truth's"
    )


def crps(run: Dataset, name: str | None, *, each: bool) -> DataArray:
    """Return the continuous ranked probability score: see ``RunAccessor.crps``."""
    name = state_variable(run, name)
    truth = truth_of(run, name)
    require_members(run, name, "scores of the ensemble (CRPS)")
    nodes = [dim for dim in [node_dim(truth)] if dim]

    def of_row(ensemble: Ensemble | None, true: Array) -> Array:
        wanted = np.atleast_1d(true)
        found = np.full(wanted.shape, np.nan) if ensemble is None else crps_of(ensemble, wanted)
        return found if nodes and each else np.asarray(found.mean())

    found = with_members(run, name, of_row, [truth], [nodes], nodes if each else [], {})
    return found.rename(f"{name}_crps").assign_attrs(
        units=_error_units(run, name), long_name=f"continuous ranked probability score of {name}"
    )


def crps_of(ensemble: Ensemble, truth: Array) -> Array:
    """Return the CRPS (n,) of each number of an ensemble of one variable against a truth (n,).

    The double sum is one over the sorted members: with W_i the weight of the members up to the i-th, it is
    sum_i w_i x_i (2 W_i - w_i - 1). Written here, because importing scoringrules takes seconds.
    """
    space = ensemble.space
    if space.variables[0].kind is Kind.ANGLE:
        return _circular(ensemble, truth)
    off = space.difference(ensemble.members, truth)
    weights = np.full(len(off), 1.0 / len(off)) if ensemble.weights is None else ensemble.weights
    order = np.argsort(off, axis=0)
    off, share = np.take_along_axis(off, order, axis=0), weights[order]
    return np.asarray((share * (np.abs(off) - off * (2.0 * np.cumsum(share, axis=0) - share - 1.0))).sum(axis=0))


def _circular(ensemble: Ensemble, truth: Array) -> Array:
    members, space = ensemble.members, ensemble.space
    off = ensemble.average(np.abs(space.difference(members, truth)))
    between = np.stack([ensemble.average(np.abs(space.difference(members, one))) for one in members])
    return np.asarray(off - 0.5 * ensemble.average(between))


def truth_of(run: Dataset, name: str) -> DataArray:
    """Return the truth of a state variable; raises RunError if the run has none."""
    if f"{name}_truth" not in run:
        raise RunError(f"errors of '{name}' need a truth, which this run does not have: its readings are not a twin's")
    return run[f"{name}_truth"]


def error_by_row(run: Dataset, name: str, of: str, function: Callable[..., float]) -> DataArray:
    """Return ``function(space, truth, guess)`` of a state variable, row by row; ``truth`` and ``guess`` are (n,)."""
    truth, guess, space = truth_of(run, name), estimate(run, name, of), space_of(run, name)
    nodes = [dim for dim in [node_dim(truth)] if dim]

    def of_row(true: Array, guessed: Array) -> float:
        return function(space, np.atleast_1d(true), np.atleast_1d(guessed))

    return by_row(of_row, [truth, guess], [nodes, nodes])


def _error_units(run: Dataset, name: str) -> str:
    positive = space_of(run, name).variables[0].kind is Kind.POSITIVE
    return "1" if positive else str(run[f"{name}_mean"].attrs.get("units", "1"))
