"""``run.nc``: written while the run goes on, read by plain xarray. docs/run-file.md lists its names.

Row k of ``time`` is the state after k cycles. Fields are stored in single precision, parameters and scores in double.
Rows are kept back for at most ``FLUSH_SECONDS`` and then written and synchronised; a run killed at any moment leaves a
file that opens.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from dafw.core.cycle import PHASES, Cycle, Parts, State
from dafw.core.diagnostics import SCORES, scores
from dafw.core.ensemble import Diagnostic
from dafw.core.errors import ContractError, RunError
from dafw.core.space import Array, Kind, Variable
from dafw.core.ugrid import write_domain

FLUSH_SECONDS = 0.5
CHUNK_NUMBERS = 4096
SHORT_ROW = 64
KIND_NOTES = {Kind.FIELD: "", Kind.NONNEGATIVE: "nonnegative", Kind.ANGLE: "angle in [0, 2 pi)"}
STAGES = {
    "truth": "truth",
    "free": "free run",
    "forecast_mean": "mean of the forecast",
    "forecast_spread": "standard deviation of the forecast",
    "mean": "mean of the analysis",
    "spread": "standard deviation of the analysis",
}


class Record:
    """Writes one run. ``whole`` names the state variables of which every member is kept."""

    def __init__(
        self,
        path: Path,
        parts: Parts,
        state: State,
        *,
        whole: Sequence[str],
        section: Array,
        attributes: Mapping[str, str | int],
    ) -> None:
        import netCDF4

        self.path, self._space = path, parts.model.space
        self._whole = tuple(whole)
        try:
            self._file = netCDF4.Dataset(path, "w", clobber=False, format="NETCDF4")
        except OSError as error:
            raise RunError(f"{path}: cannot be written, or holds a run already ({error})") from error
        self._rows: list[dict[str, Any]] = []
        self._written = 0
        self._flushed = perf_counter()
        self._recording = 0.0
        self.scored = self._space.variables[0].name
        self._file.setncatts({"Conventions": "CF-1.11 UGRID-1.0", "scored_variable": self.scored, **attributes})
        self._places: dict[str, Array | None] = {}
        self._meshed = parts.model.domain is not None and parts.model.domain.triangles is not None
        self._define_dimensions(len(state.belief.ensemble), len(state.vehicle.positions))
        self._define_states()
        self._define_cycle_variables()
        if parts.model.domain is not None:
            write_domain(self._file, parts.model.domain)
        if len(section):
            self._static("section_x", ("section_point",), section[:, 0], "m", "easting of the section's corners")
            self._static("section_y", ("section_point",), section[:, 1], "m", "northing of the section's corners")
        self._append(state, None, {})
        self.flush()

    def _define_dimensions(self, n_members: int, n_vehicles: int) -> None:
        self._file.createDimension("time", None)
        self._file.createDimension("observation", None)
        self._file.createDimension("member", n_members)
        self._file.createDimension("vehicle", n_vehicles)
        self._file.createDimension("phase", len(PHASES))
        phases = self._file.createVariable("phase", str, ("phase",))
        phases[:] = np.array(PHASES, dtype=object)
        phases.long_name = "phase of a cycle"

    def _static(self, name: str, dims: tuple[str, ...], values: Any, units: str, long_name: str) -> Any:
        """Write a variable that does not change with time, its dimensions made where they are missing."""
        values = np.asarray(values)
        for dim, length in zip(dims, values.shape, strict=True):
            if dim not in self._file.dimensions:
                self._file.createDimension(dim, length)
        variable = self._file.createVariable(name, values.dtype, dims)
        variable.setncatts({"units": units, "long_name": long_name})
        variable[:] = values
        return variable

    def _define(
        self, name: str, dims: tuple[str, ...], dtype: str, units: str, long_name: str, **attributes: str
    ) -> None:
        """Define a variable over time."""
        sizes = [1 if self._file.dimensions[dim].isunlimited() else len(self._file.dimensions[dim]) for dim in dims]
        fill = np.nan if dtype[0] == "f" else -1
        # Short rows share a chunk, and are not worth the compressor's time.
        row_length = max(1, math.prod(sizes[1:]))
        compressed = row_length > SHORT_ROW
        chunks = [max(1, min(1024, CHUNK_NUMBERS // row_length)), *sizes[1:]]
        if "observation" in dims:
            chunks = [64, 16]
        variable = self._file.createVariable(
            name,
            dtype,
            dims,
            zlib=compressed,
            complevel=1,
            fill_value=fill,
            chunksizes=chunks if 0 not in chunks else None,
        )
        variable.setncatts({"units": units, "long_name": long_name, **attributes})

    def _dims(self, variable: Variable) -> tuple[str, ...]:
        """Return the dimensions of a state variable besides time; the first with several numbers owns ``node``."""
        if variable.size == 1:
            return ()
        for candidate in ("node", f"node_{variable.name}"):
            if candidate not in self._file.dimensions:
                self._file.createDimension(candidate, variable.size)
                self._places[candidate] = variable.coordinates
                if variable.coordinates is not None:
                    self._write_coordinates(candidate, variable.coordinates)
            places, fits = self._places[candidate], len(self._file.dimensions[candidate]) == variable.size
            if fits and (variable.coordinates is None or _same(places, variable.coordinates)):
                return (candidate,)
        raise ContractError(f"no dimension fits the variable '{variable.name}'")

    def _write_coordinates(self, dim: str, coordinates: Array) -> None:
        for axis, column in zip("xyz", coordinates.T, strict=False):
            self._static(f"{dim}_{axis}", (dim,), column, "m", f"{axis} coordinate of the nodes")

    def _define_states(self) -> None:
        for variable in self._space.variables:
            dims = self._dims(variable)
            title = variable.long_name or variable.name.replace("_", " ")
            attributes = {"comment": KIND_NOTES[variable.kind]} if KIND_NOTES[variable.kind] else {}
            if dims and variable.coordinates is not None:
                axes = "xyz"[: variable.coordinates.shape[1]]
                attributes["coordinates"] = " ".join(f"{dims[0]}_{axis}" for axis in axes)
            if dims == ("node",) and self._meshed:
                attributes |= {"mesh": "mesh2d", "location": "node"}
            dtype = "f4" if dims else "f8"
            for stage, label in STAGES.items():
                name, long_name = f"{variable.name}_{stage}", f"{title}, {label}"
                self._define(name, ("time", *dims), dtype, variable.units, long_name, **attributes)
            if variable.name in self._whole:
                name, long_name = f"{variable.name}_members", f"{title}, every member of the analysis"
                self._define(name, ("time", "member", *dims), dtype, variable.units, long_name, **attributes)

    def _define_cycle_variables(self) -> None:
        self._define("time", ("time",), "f8", "s", "time since the start", axis="T")
        for name, label in (("err", "belief"), ("err_forecast", "forecast"), ("err_free", "free run")):
            long_name = f"relative l2 difference of the {label}'s {self.scored} from the truth"
            self._define(name, ("time",), "f8", "percent", long_name)
        units = self._space.variables[0].units
        self._define("rmse", ("time",), "f8", units, f"root mean square of the belief's {self.scored} less the truth's")
        self._define("spread", ("time",), "f8", units, f"root mean square of the belief's spread of {self.scored}")
        for axis in "xy":
            self._define(f"vehicle_{axis}", ("time", "vehicle"), "f8", "m", f"{axis} coordinate of the vehicles")
            name, long_name = f"observation_{axis}", f"{axis} coordinate of the readings"
            self._define(name, ("time", "observation"), "f8", "m", long_name)
        self._define("observation_value", ("time", "observation"), "f8", "1", "readings")
        self._define(
            "observation_forecast_mean", ("time", "observation"), "f8", "1", "readings that the belief expected"
        )
        self._define(
            "observation_variance", ("time", "observation"), "f8", "1", "error variance that the filter is told"
        )
        self._define("observation_node", ("time", "observation"), "i4", "1", "node that was read, -1 for none")
        self._define("phase_seconds", ("time", "phase"), "f8", "s", "wall time of the phases of a cycle")

    def append(self, cycle: Cycle) -> dict[str, float]:
        """Add a finished cycle; return its scores."""
        begun = perf_counter()
        row = self._append(cycle.state, cycle, {})
        if perf_counter() - self._flushed > FLUSH_SECONDS:
            self.flush()
        self._recording = perf_counter() - begun
        return {name: row[name] for name in SCORES}

    def _append(self, state: State, cycle: Cycle | None, row: dict[str, Any]) -> dict[str, Any]:
        belief, truth = state.belief.ensemble, state.truth.ensemble
        free = state.free.ensemble if state.free else None
        forecast = cycle.forecast if cycle else None
        stages: dict[str, Array | None] = {
            "truth": truth.members[0],
            "free": free.members[0] if free else None,
            "forecast_mean": forecast.mean if forecast else None,
            "forecast_spread": forecast.spread if forecast else None,
            "mean": belief.mean,
            "spread": belief.spread,
        }
        for stage, vector in stages.items():
            if vector is not None:
                for name, values in self._space.unpack(vector).items():
                    row[f"{name}_{stage}"] = _squeeze(values)
        for name in self._whole:
            row[f"{name}_members"] = _squeeze(belief.members[:, self._space.slice(name)])
        row["time"] = belief.time
        row["vehicle_x"], row["vehicle_y"] = state.vehicle.positions.T
        row |= scores(self._space, truth.members[0], belief, forecast, free)
        if cycle is not None:
            row |= self._cycle_row(cycle)
        self._rows.append(row)
        return row

    def _cycle_row(self, cycle: Cycle) -> dict[str, Any]:
        operator = cycle.observation.operator
        covariance = cycle.observation.covariance
        # How long recording took is known when it is done: the row after it says so.
        seconds = cycle.seconds | {"record": self._recording}
        row: dict[str, Any] = {
            "observation_value": cycle.observation.values,
            "observation_forecast_mean": cycle.predicted.mean(axis=0),
            "observation_variance": covariance if covariance.ndim == 1 else np.diag(covariance),
            "phase_seconds": [seconds.get(phase, np.nan) for phase in PHASES],
        }
        if (indices := getattr(operator, "indices", None)) is not None:
            row["observation_node"] = np.where(indices < self._space.variables[0].size, indices, -1)
        if operator.coordinates is not None:
            for axis, column in zip("xy", operator.coordinates.T, strict=False):
                row[f"observation_{axis}"] = column
        for kind, diagnostics in cycle.diagnostics.items():
            for name, diagnostic in diagnostics.items():
                row[f"{kind}_{name}"] = self._diagnostic(f"{kind}_{name}", diagnostic)
        return row

    def _diagnostic(self, name: str, diagnostic: Diagnostic) -> Any:
        """Return a diagnostic's values, its variable defined when it is first met."""
        values = np.asarray(diagnostic.values)
        if name not in self._file.variables:
            for dim, length in zip(diagnostic.dims, values.shape, strict=True):
                if dim not in self._file.dimensions:
                    self._file.createDimension(dim, length)
            dtype = {"f": "f8", "i": "i4", "u": "i4", "b": "i1"}[values.dtype.kind]
            title = diagnostic.long_name or name.replace("_", " ")
            self._define(name, ("time", *diagnostic.dims), dtype, diagnostic.units, title)
        expected = tuple(len(self._file.dimensions[dim]) for dim in self._file.variables[name].dimensions[1:])
        if values.shape != expected:
            raise ContractError(f"diagnostic '{name}' must have the shape {expected}, got {values.shape}")
        return values

    def flush(self) -> None:
        """Write what is kept back and synchronise."""
        first, last = self._written, self._written + len(self._rows)
        for name in dict.fromkeys(name for row in self._rows for name in row):
            variable = self._file.variables[name]
            fill = variable._FillValue
            block = _block([np.asarray(row.get(name, fill)) for row in self._rows], fill, variable.dtype)
            if block.size:
                variable[(slice(first, last), *map(slice, block.shape[1:]))] = block
        self._rows.clear()
        self._written = last
        self._file.sync()
        self._flushed = perf_counter()

    def close(self) -> None:
        """Write the rest and close the file."""
        if self._file.isopen():
            self.flush()
            self._file.close()


def _block(rows: list[Any], fill: Any, dtype: Any) -> Any:
    """Return rows of different lengths as one array, padded with ``fill``; a row that is missing is one ``fill``."""
    if len({row.shape for row in rows}) == 1:
        return np.array(rows, dtype=dtype)
    deepest = max(row.ndim for row in rows)
    lengths = np.max([row.shape for row in rows if row.ndim == deepest], axis=0)
    block: Any = np.full((len(rows), *lengths), fill, dtype=dtype)
    for number, row in enumerate(rows):
        block[(number, *map(slice, row.shape))] = row
    return block


def _same(a: Array | None, b: Array) -> bool:
    return a is not None and np.array_equal(a, b)


def _squeeze(values: Array) -> Array:
    """Return the values of a variable of size 1 without their last axis."""
    return values[..., 0] if values.shape[-1] == 1 else values
