"""The truth that a simulation played, in ``truth.nc``; and what a belief is worth beside it.

ERR = |mean - truth|_2 / |truth|_2 in per cent of the first state variable, as in every run with a truth; the mean is
the one in ``run.nc``, which is in single precision.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import netCDF4
import numpy as np

from dafw.core.diagnostics import error_of
from dafw.core.ensemble import Ensemble
from dafw.core.errors import RunError
from dafw.core.run_layout import CACHE
from dafw.core.runs import open_run
from dafw.core.space import Array, Kind, StateSpace, Variable

FILE = "truth.nc"
NEAR = 1e-6
"""Seconds by which times of the same cycle may differ."""


class TruthFile:
    """Writes a truth, a row after each cycle, in double precision. Raises RunError if the file exists already."""

    def __init__(self, path: Path, space: StateSpace, attributes: dict[str, Any]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._file = netCDF4.Dataset(path, "w", clobber=False, format="NETCDF4")
        except OSError as error:
            raise RunError(f"{path}: is there already, or cannot be written; nothing was changed ({error})") from None
        self._space = space
        self._file.setncatts({"Conventions": "CF-1.11", "scored_variable": space.variables[0].name, **attributes})
        self._file.createDimension("time", None)
        time = self._file.createVariable("time", "f8", ("time",))
        time.setncatts({"units": "s", "long_name": "time since the start"})
        for variable in space.variables:
            dims: tuple[str, ...] = ("time",)
            if variable.size > 1:
                self._file.createDimension(f"{variable.name}_entry", variable.size)
                dims = ("time", f"{variable.name}_entry")
            made = self._file.createVariable(f"{variable.name}_truth", "f8", dims, chunk_cache=CACHE)
            title = f"{variable.long_name or variable.name.replace('_', ' ')}, truth"
            made.setncatts({"units": variable.units, "long_name": title, "kind": variable.kind.value})

    def append(self, truth: Ensemble) -> None:
        """Add a row: the truth, one member in the belief's state space."""
        row = len(self._file.dimensions["time"])
        for variable in self._space.variables:
            part = truth.members[0, self._space.slice(variable.name)]
            self._file[f"{variable.name}_truth"][row] = part if variable.size > 1 else part[0]
        self._file["time"][row] = truth.time
        self._file.sync()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def scores_of(run: Path, truth: Path | None = None) -> dict[str, Any]:
    """Return how a run compares with the truth of a simulation, which is ``truth.nc`` in its folder unless named.

    ``time`` (s) and ``err`` (%) of the rows that both files have, ``err_free`` where the run has a free run, and by
    name the final truth, mean and spread of ``parameters``. Raises RunError if a file cannot be read or they do not
    belong together.
    """
    path = (run if run.is_dir() else run.parent) / FILE if truth is None else truth
    if not path.is_file():
        raise RunError(f"{path}: there is no such file (dafw simulate writes it)")
    with open_run(run) as belief, open_run(path) as told:
        name = str(belief.attrs["scored_variable"])
        if told.attrs.get("scored_variable") != name or "seed" not in told.attrs:
            raise RunError(f"{path}: is not the truth of a study like that of {run}")
        if belief.attrs.get("seed") != told.attrs["seed"]:
            raise RunError(f"{path}: its seed is {told.attrs['seed']}, that of {run} is {belief.attrs.get('seed')}")
        rows = _same_times(belief["time"].values, told["time"].values)
        field = told[f"{name}_truth"]
        mean = belief[f"{name}_mean"]
        if not rows or mean.shape[1:] != field.shape[1:]:
            raise RunError(f"{path}: its times or its '{name}' are not those of {run}")
        space = StateSpace([Variable(name, field.shape[1] if field.ndim > 1 else 1, Kind(field.attrs["kind"]))])
        found: dict[str, Any] = {"time": [float(belief["time"][mine]) for mine, _ in rows]}
        found["err"] = _errors(space, mean, field, rows)
        if f"{name}_free" in belief:
            found["err_free"] = _errors(space, belief[f"{name}_free"], field, rows)
        last, last_true = rows[-1]
        found["parameters"] = {
            (parameter := str(key).removesuffix("_truth")): {
                "truth": float(values[last_true]),
                "mean": float(belief[f"{parameter}_mean"][last]),
                "spread": float(belief[f"{parameter}_spread"][last]),
            }
            for key, values in told.items()
            if values.ndim == 1 and f"{str(key).removesuffix('_truth')}_mean" in belief
        }
        return found


def _same_times(mine: Array, theirs: Array) -> list[tuple[int, int]]:
    """Return the numbers of the rows that both have, by their times."""
    if not len(theirs):
        return []
    places = np.abs(theirs[np.newaxis] - mine[:, np.newaxis]).argmin(axis=1)
    return [(row, int(place)) for row, place in enumerate(places) if abs(theirs[place] - mine[row]) <= NEAR]


def _errors(space: StateSpace, ours: Any, true: Any, rows: list[tuple[int, int]]) -> list[float]:
    return [
        float(error_of(space, np.atleast_1d(true[t].values), np.atleast_1d(ours[m].values).astype(np.float64)))
        for m, t in rows
    ]
