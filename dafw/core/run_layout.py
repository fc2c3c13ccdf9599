"""The layout of ``run.nc``: its dimensions, and the variables that every run has."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dafw.core.cycle import PHASES, Parts
from dafw.core.errors import ContractError
from dafw.core.space import Array, Kind, StateSpace, Variable
from dafw.core.ugrid import write_domain

CHUNK_NUMBERS = 4096
CACHE, READINGS_CACHE = 1 << 16, 1 << 18
"""Bytes of a variable, and of one of readings, that HDF5 may hold in memory. By default it holds 64 MB of each."""
GROWING = ("time", "observation", "sensor")
"""The dimensions without a limit. To netCDF, a dimension of size zero has none either; nothing is written along it."""
USES = ("used", "used_in_window", "dropped")
"""How a reading was used: at the end of its row's cycle, late but within the filter's window, or not at all."""
KIND_NOTES = {
    Kind.FIELD: "",
    Kind.NONNEGATIVE: "nonnegative",
    Kind.POSITIVE: "positive: means are geometric, spreads are of the natural logarithm",
    Kind.ANGLE: "angle in [0, 2 pi)",
}
STAGES = {
    "truth": "truth",
    "free": "free run",
    "forecast_mean": "mean of the forecast",
    "forecast_spread": "standard deviation of the forecast",
    "mean": "mean of the analysis",
    "spread": "standard deviation of the analysis",
    "smoothed_mean": "mean of the belief as last revised",
    "smoothed_spread": "standard deviation of the belief as last revised",
}


class RunLayout:
    """Defines the variables of a run in an open netCDF file.

    ``with_members`` names the state variables of which every member is kept.

    Attributes:
        fills: the missing value of each variable over time, by name; in the variable's type.
        shapes: the shape of a row of each variable, without ``time``. A dimension that grows counts one.
        fields: names of the variables over time that hold a state variable with several numbers.
    """

    def __init__(
        self, file: Any, parts: Parts, *, n_members: int, n_vehicles: int, with_members: Sequence[str], section: Array
    ) -> None:
        self._file = file
        # Kept here because looking them up in the file is slower.
        self.fills: dict[str, Any] = {}
        self.shapes: dict[str, tuple[int, ...]] = {}
        self.fields: set[str] = set()
        space, domain = parts.model.space, parts.model.domain
        self._places: dict[str, Array | None] = {}
        self._define_dimensions(n_members, n_vehicles)
        absent = {"truth": parts.truth is None, "free": parts.free is None, "smoothed": parts.filter.window == 0}
        self._stages = {name: text for name, text in STAGES.items() if not absent.get(name.split("_")[0])}
        self._define_states(space, with_members, meshed=domain is not None and domain.triangles is not None)
        self._define_cycle_variables(space.variables[0])
        if domain is not None:
            write_domain(file, domain)
        if len(section):
            self._static("section_x", ("section_point",), section[:, 0], "m", "easting of the section's corners")
            self._static("section_y", ("section_point",), section[:, 1], "m", "northing of the section's corners")

    def _define_dimensions(self, n_members: int, n_vehicles: int) -> None:
        self._file.createDimension("time", None)
        self._file.createDimension("observation", None)
        self._file.createDimension("member", n_members)
        self._file.createDimension("vehicle", n_vehicles)
        self._file.createDimension("phase", len(PHASES))
        phases = self._file.createVariable("phase_name", str, ("phase",))
        phases[:] = np.array(PHASES, dtype=object)
        phases.long_name = "name of the phase of a cycle"

    def _static(self, name: str, dims: tuple[str, ...], values: Any, units: str, long_name: str) -> Any:
        """Write a variable that does not change with time; create its dimensions if they are missing."""
        values = np.asarray(values)
        self.extend(list(zip(dims, values.shape, strict=True)))
        variable = self._file.createVariable(name, values.dtype, dims)
        variable.setncatts({"units": units, "long_name": long_name})
        variable[:] = values
        return variable

    def define(
        self, name: str, dims: tuple[str, ...], dtype: str, units: str, long_name: str, **attributes: Any
    ) -> None:
        """Define a variable over time."""
        sizes = [1 if dim in GROWING else len(self._file.dimensions[dim]) for dim in dims]
        # An integer diagnostic may be -1, so its missing value is a number that does not occur.
        fill = {"f": np.nan, "i": -1}[dtype[0]] if dtype != "i8" else np.iinfo(np.int64).min
        # Short rows share a chunk. No side of a chunk may be zero.
        row = [max(1, size) for size in sizes[1:]]
        chunks = [max(1, min(1024, CHUNK_NUMBERS // math.prod(row))), *row]
        cache = CACHE
        if "observation" in dims:
            chunks, cache = [64, 16], READINGS_CACHE
        # A coordinate has no missing values (CF).
        given = None if dims == (name,) else fill
        variable = self._file.createVariable(name, dtype, dims, fill_value=given, chunksizes=chunks, chunk_cache=cache)
        variable.setncatts({"units": units, "long_name": long_name, **attributes})
        # Written values already have the variable's type and are never masked, so netCDF4 need not convert them.
        variable.set_auto_maskandscale(False)
        self.fills[name], self.shapes[name] = variable.dtype.type(fill), tuple(sizes[1:])

    def _dims(self, variable: Variable) -> tuple[str, ...]:
        """Return a state variable's dimensions besides time; the first with several numbers gets ``node``."""
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

    def _define_states(self, space: StateSpace, with_members: Sequence[str], meshed: bool) -> None:
        for variable in space.variables:
            dims = self._dims(variable)
            title = variable.long_name or variable.name.replace("_", " ")
            attributes = {"comment": KIND_NOTES[variable.kind]} if KIND_NOTES[variable.kind] else {}
            if dims and variable.coordinates is not None:
                axes = "xyz"[: variable.coordinates.shape[1]]
                attributes["coordinates"] = " ".join(f"{dims[0]}_{axis}" for axis in axes)
            if dims == ("node",) and meshed:
                attributes |= {"mesh": "mesh2d", "location": "node"}
            dtype = "f4" if dims else "f8"
            for stage, label in self._stages.items():
                name, long_name = f"{variable.name}_{stage}", f"{title}, {label}"
                of_logarithm = variable.kind is Kind.POSITIVE and stage.endswith("spread")
                units = "1" if of_logarithm else variable.units
                self.define(name, ("time", *dims), dtype, units, long_name, **attributes)
            if variable.name in with_members:
                name, long_name = f"{variable.name}_members", f"{title}, every member of the analysis"
                self.define(name, ("time", "member", *dims), dtype, variable.units, long_name, **attributes)
            if dims:
                names = [f"{variable.name}_{stage}" for stage in (*self._stages, "members")]
                self.fields.update(names)

    def _define_cycle_variables(self, variable: Variable) -> None:
        # Error and spread of a positive variable are of its logarithm.
        scored, units = variable.name, "1" if variable.kind is Kind.POSITIVE else variable.units
        # No `axis`, no `standard_name`: for CF those are of times since a date, and a study has none.
        self.define("time", ("time",), "f8", "s", "time since the start")
        present = {stage.split("_")[0] for stage in self._stages}
        compared = {"err": "belief", "err_forecast": "forecast", "err_free": "free run", "err_smoothed": "revision"}
        scored_by = {"err_free": "free", "err_smoothed": "smoothed"}
        if "truth" not in present:
            compared = {}
        for name, label in compared.items():
            if scored_by.get(name, "truth") in present:
                long_name = f"relative l2 difference of the {label}'s {scored} from the truth"
                self.define(name, ("time",), "f8", "percent", long_name)
        if compared:
            title = f"root mean square of the belief's {scored} less the truth's"
            self.define("rmse", ("time",), "f8", units, title)
        self.define("spread", ("time",), "f8", units, f"root mean square of the belief's spread of {scored}")
        for axis in "xy":
            self.define(f"vehicle_{axis}", ("time", "vehicle"), "f8", "m", f"{axis} coordinate of the vehicles")
            name, long_name = f"observation_{axis}", f"{axis} coordinate of the readings"
            self.define(name, ("time", "observation"), "f8", "m", long_name)
        for name, dtype, long_name in (
            ("observation_value", "f8", "readings"),
            ("observation_forecast_mean", "f8", "readings that the belief expected"),
            ("observation_forecast_spread", "f8", "spread of the readings that the members expected"),
            ("observation_rank", "f8", "share of the expected readings, errors included, that are below the reading"),
            ("observation_variance", "f8", "error variance that the filter is told"),
            ("observation_node", "i4", "node that was read, -1 for none"),
        ):
            self.define(name, ("time", "observation"), dtype, "1", long_name)
        self.define("observation_time", ("time", "observation"), "f8", "s", "time of the readings")
        self.define(
            "observation_use",
            ("time", "observation"),
            "i1",
            "1",
            "what became of the readings",
            flag_values=np.arange(3, dtype="i1"),
            flag_meanings=" ".join(USES),
        )
        self.define("innovation_mean", ("time",), "f8", "1", "mean of the innovations over their expected spread")
        self.define("innovation_rms", ("time",), "f8", "1", "root mean square of the innovations, likewise")
        title = "wall time of the phases of a cycle"
        self.define("phase_seconds", ("time", "phase"), "f8", "s", title, coordinates="phase_name")

    def define_sensors(self) -> None:
        """Define the list of sensors, and the variable that refers to it."""
        self._file.createDimension("sensor", None)
        listed = self._file.createVariable("sensor_name", str, ("sensor",))
        listed.long_name = "names of the sensors"
        title = "number of the sensor in sensor_name, -1 if it is not told"
        self.define("observation_sensor", ("time", "observation"), "i4", "1", title)

    def extend(self, sizes: Sequence[tuple[str, int]]) -> None:
        """Create the dimensions that are missing, with their sizes."""
        for dim, length in sizes:
            if dim not in self._file.dimensions:
                self._file.createDimension(dim, length)


def _same(a: Array | None, b: Array) -> bool:
    return a is not None and np.array_equal(a, b)
