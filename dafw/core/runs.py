"""Opening the files of a run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dafw.core.errors import RunError

if TYPE_CHECKING:
    import xarray

NO_TIME = 9e36
"""Below what netCDF has for a number that was not written. Coordinates have no missing values in CF."""


def open_run(path: str | Path, *, indexed: bool = True) -> xarray.Dataset:
    """Open a run's folder, or its ``run.nc``, as a lazy Dataset; this works also while the run goes on.

    The Dataset's ``dafw`` computes what is asked for after a run: dafw/core/accessor. Without ``indexed`` nothing can
    be selected by its time, only by its row; xarray then need not import pint for the index, which takes 0.2 s.

    Raises RunError if there is no run or the file cannot be read.
    """
    import xarray

    import dafw.core.accessor  # noqa: F401 - so that the Dataset has ``dafw``
    from dafw.core.run_store import opened_store

    file = Path(path) / "run.nc" if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise RunError(f"{path}: holds no run (expected a run's folder or its run.nc)")
    with opened_store(file) as store:
        # Keep times and phases as plain numbers of seconds; xarray would convert them to timedelta.
        found = xarray.open_dataset(store, decode_times=False, create_default_indexes=indexed)
        if "time" not in found.coords:
            return found
        written = found["time"].values < NO_TIME  # a row that is just being written may not have its time yet
        return found if written.all() else found.isel(time=np.flatnonzero(written))


def summary_of(folder: Path) -> dict[str, Any]:
    """Return the summary that a run left in its folder; empty if there is none that can be read."""
    try:
        found = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
