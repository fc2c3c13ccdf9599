"""A sweep as a table: one row a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from xarray import Dataset

from dafw.core.errors import RunError
from dafw.core.runs import summary_of
from dafw.core.sweeps import SWEEP_FOLDER

if TYPE_CHECKING:
    import pandas


def table(sweep: Dataset) -> pandas.DataFrame:
    """Return one row a run, in the order of the grid: parameters, ``status``, ``folder``, numbers of its summary.

    Of the nested numbers of ``summary.json``, ``parameters_final`` become ``<variable>_mean``, ``_spread`` and
    ``_truth``, the others are named like ``readings_on_time``. What a run does not have is NaN. A summary's number that
    has the name of a parameter is left out. Raises RunError if the Dataset is not that of ``dafw.open_sweep``.
    """
    import pandas

    if SWEEP_FOLDER not in sweep.attrs or not {"status", "folder"} <= set(sweep.variables):
        raise RunError("a table needs a sweep, as dafw.open_sweep returns it; this is something else")
    root, status, folder = Path(str(sweep.attrs[SWEEP_FOLDER])), sweep["status"], sweep["folder"].values
    rows = []
    for place in np.ndindex(status.shape):
        here = dict(zip(map(str, status.dims), place, strict=True))
        row = {
            str(name): coordinate.values[tuple(here[str(dim)] for dim in coordinate.dims)].item()
            for name, coordinate in status.coords.items()
        }
        row |= {"status": str(status.values[place]), "folder": str(folder[place])}
        summary = summary_of(root / row["folder"]) if row["folder"] else {}
        row |= {name: value for name, value in _scalars(summary) if name not in row}
        rows.append(row)
    return pandas.DataFrame(rows)


def _scalars(summary: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the numbers of a summary by name."""
    for name, value in summary.items():
        if name == "parameters_final":
            for variable, stages in value.items():
                yield from ((f"{variable}_{stage}", _number(one)) for stage, one in stages.items())
        elif name in ("readings", "phase_seconds", "forecasts"):
            yield from ((f"{name}_{part}", _number(one)) for part, one in (value or {}).items())
        elif value is None or isinstance(value, (int, float)):
            yield name, _number(value)


def _number(value: Any) -> Any:
    return float("nan") if value is None else value
