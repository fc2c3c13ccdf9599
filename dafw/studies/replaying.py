"""Making a run again from what its folder says, and naming the first difference between the two."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dafw.core.checkpoints.fingerprint import changed_since, changed_versions
from dafw.core.errors import RunError
from dafw.core.forecasts.forecast_file import FILE, open_forecasts
from dafw.core.pinned import pinned_study
from dafw.core.runs import open_run, summary_of
from dafw.studies.run_configuration import configuration_of, in_working_folder
from dafw.studies.running import run_study
from dafw.studies.summary import versions_of

if TYPE_CHECKING:
    from xarray import DataArray, Dataset

MEASURED = ("phase_seconds",)
"""Variables that hold measured times, which are never the same."""
SAID_FIRST = ("versions", "dafw_version")
"""Attributes of a file that are compared before the run is made again."""
QUIET = {"pictures": False, "resume": "never", "checkpoint": {"every": None, "cycles": None}, "advice": []}


@dataclass(frozen=True)
class Prepared:
    """A run that can be made again: its study, and in words which versions and files are other ones now."""

    folder: Path
    study: Any
    versions: list[str]
    files: list[str]


def prepared(folder: Path) -> Prepared:
    """Return what is needed to make a run again. Raises RunError if the folder holds no complete run."""
    from dafw.core.experiment import study_from

    summary = summary_of(folder)
    if not (folder / "run.nc").is_file():
        raise RunError(f"{folder}: holds no run (expected the folder of a run, with its run.nc)")
    if (status := summary.get("status")) != "complete":
        raise RunError(f"{folder}: the run is not complete ({status or 'it left no summary'}): dafw resume goes on")
    with in_working_folder(folder):
        study = study_from({**configuration_of(folder), **QUIET})
        study = pinned_study(study, summary.get("pinned") or {})
        study = replace(study, readings=study.readings.again(folder))
        files = changed_since(summary.get("files") or {}, {})
    return Prepared(folder, study, changed_versions(summary.get("versions") or {}, versions_of(study)), files)


def first_difference(run: Prepared) -> str:
    """Make the run again in a temporary folder, and return in words where it first differs; '' if it does not."""
    with tempfile.TemporaryDirectory(prefix="dafw-replay-") as place, in_working_folder(run.folder):
        again = Path(place, "run")
        run_study(run.study, again)
        with open_run(run.folder) as before, open_run(again) as now:
            if found := difference_of(before, now, "time"):
                return found
        if (run.folder / FILE).is_file() != (again / FILE).is_file():
            return f"{FILE}: only one of the two runs has forecasts"
        if (again / FILE).is_file():
            with open_forecasts(run.folder) as before, open_forecasts(again) as now:
                if found := difference_of(before, now, "issue"):
                    return f"{FILE}: {found}"
    return ""


def difference_of(before: Dataset, now: Dataset, along: str) -> str:
    """Return in words the first difference of two files, by the dimension ``along``, to the last bit; '' if none.

    What does not change in time comes first, then the rows in their order, and of a row the variables in the order of
    the file. Revised beliefs come last: a difference in a later row also changes them in earlier ones.
    """
    for name in (name for name in dict.fromkeys([*before.variables, *now.variables]) if name not in MEASURED):
        if name not in before.variables or name not in now.variables:
            return f"variable {name}: only the run {'that was made' if name in before.variables else 'made now'} has it"
    for name in dict.fromkeys([*before.attrs, *now.attrs]):
        if name not in SAID_FIRST and not _same(before.attrs.get(name), now.attrs.get(name)):
            return f"attribute {name}: was {before.attrs.get(name)}, is {now.attrs.get(name)}"
    differing = sorted(_differing(before, now, along))
    if not differing:
        return ""
    (_, row, name), number = differing[0], len(differing)
    others = "1 more variable differs" if number == 2 else f"{number - 1} more variables differ"
    more = f"; {others}, there or later" if number > 1 else ""
    if row == -2:
        return f"{name}: {_shape_or_attributes(before[name], now[name])}{more}"
    return f"{_told(before, now, name, row, along)}{more}"


def _differing(before: Dataset, now: Dataset, along: str) -> Iterator[tuple[tuple[bool, int, int], int, str]]:
    """Yield what differs: a key for sorting, the first row (-1: it has no rows, -2: its form differs), the name."""
    for place, name in enumerate(map(str, before.variables)):
        if name in MEASURED:
            continue
        one, other = before[name], now[name]
        if _shape_or_attributes(one, other):
            row = -2
        elif not (differs := _unequal(one.values, other.values)).any():
            continue
        else:
            row = int(np.argwhere(differs)[0][0]) if one.dims[:1] == (along,) else -1
        yield ("_smoothed" in name, row, place), row, name


def _told(before: Dataset, now: Dataset, name: str, row: int, along: str) -> str:
    """Return where and how a variable differs first, from its first differing row on."""
    one, other = before[name], now[name]
    values, others, dims = one.values, other.values, [str(dim) for dim in one.dims]
    where = [name]
    if row >= 0:
        values, others, dims = values[row], others[row], dims[1:]
        where.append(f"at {along} {float(before[along][row]):g} s")
    differs = np.atleast_1d(_unequal(np.atleast_1d(values), np.atleast_1d(others)))
    index = tuple(int(number) for number in np.argwhere(differs)[0]) if dims else ()
    where += [f"{dim} {number}{_coordinates(before, dim, number)}" for dim, number in zip(dims, index, strict=True)]
    of = f" ({int(differs.sum())} of {differs.size} numbers there)" if differs.size > 1 else ""
    return f"{', '.join(where)}: was {_written(values, index)}, is {_written(others, index)}{of}"


def _coordinates(run: Dataset, dim: str, number: int) -> str:
    axes = [f"{dim}_{axis}" for axis in "xyz" if f"{dim}_{axis}" in run.variables]
    placed = [float(run[axis].values[number]) for axis in axes if run[axis].dims == (dim,)]
    return f" ({', '.join(f'{value:g}' for value in placed)} m)" if placed else ""


def _written(values: Any, index: tuple[int, ...]) -> str:
    value = np.asarray(values)[index]
    return repr(value.item()) if isinstance(value, np.generic) else repr(value)


def _shape_or_attributes(one: DataArray, other: DataArray) -> str:
    if (one.dims, one.shape, one.dtype) != (other.dims, other.shape, other.dtype):
        return f"was {one.dtype} {dict(one.sizes)}, is {other.dtype} {dict(other.sizes)}"
    for name in dict.fromkeys([*one.attrs, *other.attrs]):
        if not _same(one.attrs.get(name), other.attrs.get(name)):
            return f"its attribute {name} was {one.attrs.get(name)}, is {other.attrs.get(name)}"
    return ""


def _same(one: Any, other: Any) -> bool:
    return bool(np.array_equal(np.asarray(one), np.asarray(other)))


def _unequal(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return where two arrays of the same type differ in their bits."""
    if one.dtype.kind != "f":
        return np.asarray(one != other)
    kind = f"u{one.dtype.itemsize}"
    return np.asarray(np.ascontiguousarray(one).view(kind) != np.ascontiguousarray(other).view(kind))
