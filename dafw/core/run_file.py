"""The netCDF file ``run.nc``: its dimensions and variables, and how rows of them are stored.

Nothing is compressed: noisy fields hardly shrink, and compressing takes ten times as long as writing
(docs/run-file.md).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

# Imported before any plugin is loaded: dolfinx.fem.petsc makes the symbols of its own HDF5 library visible to all
# libraries loaded after it, and netCDF4 cannot write with those.
import netCDF4
import numpy as np

from dafw.core.checkpoints.journal import Journal
from dafw.core.cycle import PHASES, Parts
from dafw.core.ensemble import Diagnostic
from dafw.core.errors import ContractError, RunError
from dafw.core.space import Array, Kind, StateSpace, Variable
from dafw.core.ugrid import write_domain

CHUNK_NUMBERS = 4096
CACHE, READINGS_CACHE = 1 << 16, 1 << 18
"""Bytes of a variable, and of one of readings, that HDF5 may hold in memory. By default it holds 64 MB of each."""
HDF_ERROR = -101
"""The number of netCDF's error when HDF5 fails."""
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


def _hidden_library(error: OSError) -> bool:
    """Return whether netCDF4 may be using the HDF5 library of DOLFINx."""
    return error.errno == HDF_ERROR and "dolfinx.fem.petsc" in sys.modules


class RunFile:
    """A new file with all variables of a run except diagnostics, which are defined when they first occur.

    ``with_members`` names the state variables of which every member is kept. A ``journal`` is told of everything that
    is written later (``repeat`` writes it again). Raises RunError if the file cannot be made.
    """

    def __init__(
        self,
        path: Path,
        parts: Parts,
        *,
        n_members: int,
        n_vehicles: int,
        with_members: Sequence[str],
        section: Array,
        attributes: Mapping[str, str | int],
        journal: Journal | None = None,
    ) -> None:
        self._journal = journal
        self._rewritten: dict[int, set[str]] = {}
        try:
            self._file = netCDF4.Dataset(path, "w", clobber=False, format="NETCDF4")
        except OSError as error:
            hint = "; import netCDF4 before dolfinx.fem.petsc" if _hidden_library(error) else ""
            raise RunError(f"{path}: cannot be written, or holds a run already ({error}){hint}") from error
        # Kept here because looking them up in the file is slower.
        self._fills: dict[str, Any] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._fields: set[str] = set()
        self._sensors: dict[str, int] = {}
        self._written = 0
        self._extents: dict[str, tuple[int, int]] = {}  # of the variables of readings that have values
        space, domain = parts.model.space, parts.model.domain
        scored = space.variables[0].name
        self._file.setncatts({"Conventions": "CF-1.11 UGRID-1.0", "scored_variable": scored, **attributes})
        self._places: dict[str, Array | None] = {}
        self._define_dimensions(n_members, n_vehicles)
        absent = {"truth": parts.truth is None, "free": parts.free is None, "smoothed": parts.filter.window == 0}
        self._stages = {name: text for name, text in STAGES.items() if not absent.get(name.split("_")[0])}
        self._define_states(space, with_members, meshed=domain is not None and domain.triangles is not None)
        self._define_cycle_variables(scored, space.variables[0].units)
        if domain is not None:
            write_domain(self._file, domain)
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
        for dim, length in zip(dims, values.shape, strict=True):
            if dim not in self._file.dimensions:
                self._file.createDimension(dim, length)
        variable = self._file.createVariable(name, values.dtype, dims)
        variable.setncatts({"units": units, "long_name": long_name})
        variable[:] = values
        return variable

    def _define(
        self, name: str, dims: tuple[str, ...], dtype: str, units: str, long_name: str, **attributes: Any
    ) -> None:
        """Define a variable over time."""
        sizes = [1 if self._file.dimensions[dim].isunlimited() else len(self._file.dimensions[dim]) for dim in dims]
        # An integer diagnostic may be -1, so its missing value is a number that does not occur.
        fill = {"f": np.nan, "i": -1}[dtype[0]] if dtype != "i8" else np.iinfo(np.int64).min
        # Short rows share a chunk.
        chunks = [max(1, min(1024, CHUNK_NUMBERS // max(1, math.prod(sizes[1:])))), *sizes[1:]]
        cache = CACHE
        if "observation" in dims:
            chunks, cache = [64, 16], READINGS_CACHE
        # A coordinate has no missing values (CF).
        given = None if dims == (name,) else fill
        variable = self._file.createVariable(
            name, dtype, dims, fill_value=given, chunksizes=chunks if 0 not in chunks else None, chunk_cache=cache
        )
        variable.setncatts({"units": units, "long_name": long_name, **attributes})
        # Written values already have the variable's type and are never masked, so netCDF4 need not convert them.
        variable.set_auto_maskandscale(False)
        self._fills[name], self._shapes[name] = variable.dtype.type(fill), tuple(sizes[1:])

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
                self._define(name, ("time", *dims), dtype, variable.units, long_name, **attributes)
            if variable.name in with_members:
                name, long_name = f"{variable.name}_members", f"{title}, every member of the analysis"
                self._define(name, ("time", "member", *dims), dtype, variable.units, long_name, **attributes)
            if dims:
                names = [f"{variable.name}_{stage}" for stage in (*self._stages, "members")]
                self._fields.update(names)

    def _define_cycle_variables(self, scored: str, units: str) -> None:
        # No `axis`, no `standard_name`: for CF those are of times since a date, and a study has none.
        self._define("time", ("time",), "f8", "s", "time since the start")
        present = {stage.split("_")[0] for stage in self._stages}
        compared = {"err": "belief", "err_forecast": "forecast", "err_free": "free run", "err_smoothed": "revision"}
        scored_by = {"err_free": "free", "err_smoothed": "smoothed"}
        if "truth" not in present:
            compared = {}
        for name, label in compared.items():
            if scored_by.get(name, "truth") in present:
                long_name = f"relative l2 difference of the {label}'s {scored} from the truth"
                self._define(name, ("time",), "f8", "percent", long_name)
        if compared:
            title = f"root mean square of the belief's {scored} less the truth's"
            self._define("rmse", ("time",), "f8", units, title)
        self._define("spread", ("time",), "f8", units, f"root mean square of the belief's spread of {scored}")
        for axis in "xy":
            self._define(f"vehicle_{axis}", ("time", "vehicle"), "f8", "m", f"{axis} coordinate of the vehicles")
            name, long_name = f"observation_{axis}", f"{axis} coordinate of the readings"
            self._define(name, ("time", "observation"), "f8", "m", long_name)
        for name, dtype, long_name in (
            ("observation_value", "f8", "readings"),
            ("observation_forecast_mean", "f8", "readings that the belief expected"),
            ("observation_forecast_spread", "f8", "spread of the readings that the members expected"),
            ("observation_rank", "f8", "share of the expected readings, errors included, that are below the reading"),
            ("observation_variance", "f8", "error variance that the filter is told"),
            ("observation_node", "i4", "node that was read, -1 for none"),
        ):
            self._define(name, ("time", "observation"), dtype, "1", long_name)
        self._define("observation_time", ("time", "observation"), "f8", "s", "time of the readings")
        self._define(
            "observation_use",
            ("time", "observation"),
            "i1",
            "1",
            "what became of the readings",
            flag_values=np.arange(3, dtype="i1"),
            flag_meanings=" ".join(USES),
        )
        self._define("innovation_mean", ("time",), "f8", "1", "mean of the innovations over their expected spread")
        self._define("innovation_rms", ("time",), "f8", "1", "root mean square of the innovations, likewise")
        title = "wall time of the phases of a cycle"
        self._define("phase_seconds", ("time", "phase"), "f8", "s", title, coordinates="phase_name")

    def require(self, name: str, diagnostic: Diagnostic, values: Any) -> None:
        """Define a diagnostic's variable if it is new; raises ContractError if the values do not fit into it."""
        if name in self._shapes and values.shape == self._shapes[name] and values.dtype == self._fills[name].dtype:
            return
        dtype = {"f": "f8", "i": "i8", "u": "i8", "b": "i1"}[values.dtype.kind]
        if name not in self._shapes:
            for dim, length in zip(diagnostic.dims, values.shape, strict=True):
                if dim not in self._file.dimensions:
                    self._file.createDimension(dim, length)
            title = diagnostic.long_name or name.replace("_", " ")
            self._define(name, ("time", *diagnostic.dims), dtype, diagnostic.units, title)
            sizes = [*zip(diagnostic.dims, values.shape, strict=True)]
            self._note({"diagnostic": name, "sizes": sizes, "dtype": dtype, "units": diagnostic.units, "title": title})
        if values.shape != self._shapes[name]:
            raise ContractError(f"diagnostic '{name}' must have the shape {self._shapes[name]}, got {values.shape}")
        kept = self._fills[name].dtype
        if not np.can_cast(dtype, kept) and kept.kind != "f":
            raise ContractError(f"diagnostic '{name}' was of the type {kept} at first, got {values.dtype}")
        if values.dtype.kind == "u" and values.size and values.max() > np.iinfo(np.int64).max:
            raise ContractError(f"diagnostic '{name}' holds {values.max()}, a file holds whole numbers up to 2^63 - 1")

    def require_weights(self) -> None:
        """Define the variable of the members' weights if it is not there yet."""
        if "weight" not in self._shapes:
            self._define("weight", ("time", "member"), "f8", "1", "weights of the members of the analysis")
            self._note({"weights": True})

    def sensor_numbers(self, names: Sequence[str]) -> list[int]:
        """Return the numbers under which the file lists sensors; a new sensor is added."""
        if "observation_sensor" not in self._shapes:
            self._file.createDimension("sensor", None)
            listed = self._file.createVariable("sensor_name", str, ("sensor",))
            listed.long_name = "names of the sensors"
            title = "number of the sensor in sensor_name, -1 if it is not told"
            self._define("observation_sensor", ("time", "observation"), "i4", "1", title)
        for name in names:
            if name not in self._sensors:
                self._file.variables["sensor_name"][len(self._sensors)] = name
                self._sensors[name] = len(self._sensors)
                self._note({"sensor": name})
        return [self._sensors[name] for name in names]

    def write(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Add rows (values by the variable's name) and synchronise; variables that a row lacks stay missing."""
        blocks = {}
        for name in dict.fromkeys(chain.from_iterable(rows)):
            fill = self._fills[name]
            blocks[name] = _block([row.get(name, fill) for row in rows], fill)
        self._write_blocks(len(rows), blocks)
        if rows:
            self._note({"rows": len(rows)}, blocks)
        self._file.sync()

    def _write_blocks(self, count: int, blocks: Mapping[str, Any]) -> None:
        first, last = self._written, self._written + count
        for name, block in blocks.items():
            if block.size:
                self._file.variables[name][(slice(first, last), *map(slice, block.shape[1:]))] = block
                if name.startswith("observation_"):
                    _, width = self._extents.get(name, (0, 0))
                    self._extents[name] = last, max(width, block.shape[1])
        self._written = last
        self._extend()

    def _extend(self) -> None:
        """Give all variables of readings the same extent.

        Of a variable with two dimensions that grow, netCDF reads wrong numbers if it was not written as far as others
        were (seen with netCDF 4.10.1).
        """
        widest = max((width for _, width in self._extents.values()), default=0)
        for name, extent in self._extents.items():
            if extent != (self._written, widest):
                self._file.variables[name][self._written - 1, widest - 1] = self._fills[name]
                self._extents[name] = self._written, widest

    def is_field(self, name: str) -> bool:
        """Return whether a variable holds a state variable with several numbers, such as one on a mesh."""
        return name in self._fields

    def rewrite(self, row: int, values: Mapping[str, Any]) -> None:
        """Write variables of a row again; a reader may see the old or the new values until the file is synchronised."""
        for name, value in values.items():
            self._file.variables[name][row] = value
        if self._journal is not None:
            self._rewritten.setdefault(row, set()).update(values)

    def settle(self, final: int) -> dict[str, Array]:
        """Tell the journal what was written again of the rows before ``final``, for a checkpoint.

        Return the same of the later rows, which may be written once more, by ``ROW/NAME``. So the journal does not
        grow with every revision.
        """
        later: dict[str, Array] = {}
        for row in sorted(self._rewritten):
            found = {name: self._stored(name, row) for name in sorted(self._rewritten[row])}
            if row < final:
                self._note({"again": row}, found)
                del self._rewritten[row]
            else:
                later |= {f"{row}/{name}": values for name, values in found.items()}
        return later

    def repeat(self, told: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
        """Write an entry of a journal; raises LookupError or TypeError for what is none of this file's."""
        match told:
            case {"rows": int(count)}:
                self._write_blocks(count, arrays)
            case {"again": int(row)}:
                for name, values in arrays.items():
                    self._file.variables[name][row] = values
            case {"diagnostic": str(name), "sizes": sizes, "dtype": dtype, "units": units, "title": title}:
                for dim, length in sizes:
                    if dim not in self._file.dimensions:
                        self._file.createDimension(dim, length)
                self._define(name, ("time", *(dim for dim, _ in sizes)), dtype, units, title)
            case {"weights": True}:
                self.require_weights()
            case {"sensor": str(name)}:
                self.sensor_numbers([name])
            case _:
                raise LookupError(f"an entry that is not known: {sorted(told)}")

    def go_on(self, journal: Journal | None, later: Mapping[str, Any]) -> int:
        """Write what ``settle`` returned, tell ``journal`` of what follows, and return the number of rows there are."""
        self._journal = journal
        for place, values in later.items():
            row, _, name = place.partition("/")
            self.rewrite(int(row), {name: values})
        self._file.sync()
        return self._written

    def _note(self, told: Mapping[str, Any], arrays: Mapping[str, Any] | None = None) -> None:
        if self._journal is not None:
            self._journal.add(told, arrays)

    def _stored(self, name: str, row: int) -> Array:
        """Return a variable of a row as the file has it, of the same type."""
        return np.asarray(self._file.variables[name][row])

    def read(self, name: str, row: int) -> Array:
        """Return a variable of a row that was written before, as stored in the file."""
        return np.asarray(self._file.variables[name][row], dtype=np.float64)

    @property
    def is_open(self) -> bool:
        """Whether rows can still be added."""
        return bool(self._file.isopen())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _block(values: list[Any], fill: Any) -> Any:
    """Return rows of different lengths as one array, padded with ``fill``; a missing row is all ``fill``."""
    try:
        return np.array(values, dtype=fill.dtype)
    except ValueError:  # they are of different lengths
        rows = [np.asarray(value) for value in values]
    deepest = max(row.ndim for row in rows)
    lengths = np.max([row.shape for row in rows if row.ndim == deepest], axis=0)
    block: Any = np.full((len(rows), *lengths), fill)
    for number, row in enumerate(rows):
        block[(number, *map(slice, row.shape))] = row
    return block


def _same(a: Array | None, b: Array) -> bool:
    return a is not None and np.array_equal(a, b)
