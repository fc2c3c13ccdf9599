"""How xarray reads a ``run.nc`` or ``forecast.nc``: as any netCDF file, but its variables of text are read at once.

xarray imports the whole of dask.array to decode a variable of text, which takes half of the time of opening a run (0.5
of 0.9 s). A run has few texts: the names of phases, sensors, buildings and places.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from xarray import Variable
from xarray.backends import CachingFileManager, NetCDF4DataStore
from xarray.backends.netCDF4_ import NETCDF4_PYTHON_LOCK
from xarray.core.indexing import LazilyIndexedArray

from dafw.core.errors import RunError, in_one_line

UNREADABLE = (OSError, ValueError, RuntimeError, LookupError, AttributeError)
"""What reading a damaged netCDF file may raise."""


class RunStore(NetCDF4DataStore):
    """xarray's view of an open file, with texts as arrays of NumPy."""

    def open_store_variable(self, name: str, var: Any) -> Variable:
        """Return one of the file's variables."""
        variable: Variable = super().open_store_variable(name, var)
        if var.dtype is not str:
            return variable
        # Wrapped as a backend's arrays are, because xarray imports dask.array also to check an array of NumPy.
        texts = LazilyIndexedArray(np.asarray(variable.values, dtype=np.str_))
        return Variable(variable.dims, texts, variable.attrs)


@contextmanager
def opened_store(file: Path) -> Iterator[RunStore]:
    """Open a file for xarray, which reads it in the block. The file stays open, unless an error leaves the block.

    Raises RunError, which names the file, for what reading a damaged one raises.
    """
    # With weak references netCDF4 also closes a file that it finds damaged before it is open.
    options, lock = {"keepweakref": True}, NETCDF4_PYTHON_LOCK
    manager: Any = CachingFileManager(netCDF4.Dataset, str(file), mode="r", kwargs=options, lock=lock)
    with ExitStack() as stack:
        try:
            store = RunStore(manager, mode="r", lock=lock)  # type: ignore[no-untyped-call]  # xarray states no types here
            stack.callback(store.close)
            yield store
        except UNREADABLE as error:
            raise RunError(f"{file}: cannot be read as netCDF ({in_one_line(error)})") from error
        stack.pop_all()
