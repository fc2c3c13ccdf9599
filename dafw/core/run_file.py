"""The netCDF file ``run.nc``: how rows of its variables are stored. run_layout.py defines them.

Nothing is compressed: noisy fields hardly shrink, and compressing takes ten times as long as writing
(docs/run-file.md).
"""

from __future__ import annotations

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
from dafw.core.cycle import Parts
from dafw.core.ensemble import Diagnostic
from dafw.core.errors import ContractError, RunError
from dafw.core.run_layout import RunLayout
from dafw.core.space import Array, IntArray

HDF_ERROR = -101
"""The number of netCDF's error when HDF5 fails."""


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
        self._sensors: dict[str, int] = {}
        self._names: Sequence[str] | None = None
        self._numbers = np.empty(0, dtype=np.int64)
        self._written = 0
        self._extents: dict[str, tuple[int, int]] = {}  # of the variables of readings that have values
        scored = parts.model.space.variables[0].name
        self._file.setncatts({"Conventions": "CF-1.11 UGRID-1.0", "scored_variable": scored, **attributes})
        self._layout = RunLayout(
            self._file,
            parts,
            n_members=n_members,
            n_vehicles=n_vehicles,
            with_members=with_members,
            section=section,
        )
        self._fills, self._shapes = self._layout.fills, self._layout.shapes

    def require(self, name: str, diagnostic: Diagnostic, values: Any) -> None:
        """Define a diagnostic's variable if it is new; raises ContractError if the values do not fit into it."""
        if name in self._shapes and values.shape == self._shapes[name] and values.dtype == self._fills[name].dtype:
            return
        dtype = {"f": "f8", "i": "i8", "u": "i8", "b": "i1"}[values.dtype.kind]
        if name not in self._shapes:
            title = diagnostic.long_name or name.replace("_", " ")
            sizes = [*zip(diagnostic.dims, values.shape, strict=True)]
            self._layout.extend(sizes)
            self._layout.define(name, ("time", *diagnostic.dims), dtype, diagnostic.units, title)
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
            self._layout.define("weight", ("time", "member"), "f8", "1", "weights of the members of the analysis")
            self._note({"weights": True})

    def require_spans(self) -> None:
        """Define the variable of the readings' spans if it is not there yet."""
        if "observation_span" not in self._shapes:
            title = "time over which the reading is a mean, until its own"
            self._layout.define("observation_span", ("time", "observation"), "f8", "s", title)
            self._note({"spans": True})

    def sensor_numbers(self, names: Sequence[str]) -> IntArray:
        """Return the numbers under which the file lists sensors; a new sensor is added."""
        if names is self._names:  # those of the cycle before
            return self._numbers
        if "observation_sensor" not in self._shapes:
            self._layout.define_sensors()
        for name in names:
            if name not in self._sensors:
                self._file.variables["sensor_name"][len(self._sensors)] = name
                self._sensors[name] = len(self._sensors)
                self._note({"sensor": name})
        self._names, self._numbers = names, np.array([self._sensors[name] for name in names], dtype=np.int64)
        return self._numbers

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
        return name in self._layout.fields

    def as_stored(self, name: str, values: Any) -> Array:
        """Return values in the type in which the file has a variable."""
        return np.asarray(values, dtype=self._fills[name].dtype)

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
                self._layout.extend(sizes)
                self._layout.define(name, ("time", *(dim for dim, _ in sizes)), dtype, units, title)
            case {"weights": True}:
                self.require_weights()
            case {"spans": True}:
                self.require_spans()
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
