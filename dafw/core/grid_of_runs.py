"""Runs joined in one lazy Dataset: each at its place in a grid of parameters, NaN where a run has no values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from math import prod
from typing import Any

import dask.array
import numpy as np
from xarray import Dataset, Variable

from dafw.core.errors import RunError

type Place = tuple[int, ...]
type Values = np.ndarray[Any, Any]


def join(runs: Mapping[Place, Dataset], coordinates: Mapping[str, Values], told: Mapping[str, Values]) -> Dataset:
    """Return the runs (of dask arrays), by their place in the grid of ``coordinates``, as one Dataset.

    ``told`` holds what is known of every place, whether a run is there or not. Raises RunError if a variable has
    different dimensions in two runs.
    """
    labels, unlabelled = _labels(list(runs.values()))
    aligned = {place: _aligned(run, labels, unlabelled) for place, run in runs.items()}
    sizes: dict[str, int] = {}
    for run in aligned.values():
        for name, size in run.sizes.items():
            sizes[str(name)] = max(size, sizes.get(str(name), 0))
    grid = {name: len(values) for name, values in coordinates.items()}
    variables: dict[str, Variable] = {}
    for name in dict.fromkeys(str(name) for run in aligned.values() for name in run.variables if name not in labels):
        having = {place: run.variables[name] for place, run in aligned.items() if name in run.variables}
        variables[name] = _joined(name, having, grid, sizes)
    joined = Dataset(
        {name: (tuple(grid), values) for name, values in told.items()} | variables,
        {**labels, **coordinates},
        _common([run.attrs for run in runs.values()]),
    )
    joined = joined.set_coords([name for name in variables if any(name in run.coords for run in aligned.values())])
    joined.set_close(lambda: _close(runs.values()))
    return joined


def _close(runs: Any) -> None:
    for run in runs:
        run.close()


def _labels(runs: Sequence[Dataset]) -> tuple[dict[str, Variable], set[str]]:
    """Return the coordinates of the runs' own dimensions, and the dimensions whose coordinates differ between runs.

    Numeric coordinates agree if the shorter ones are the beginning of the longest. For coordinates that are names,
    the result is all names that occur in any run.
    """
    labels: dict[str, Variable] = {}
    unlabelled: set[str] = set()
    for name in dict.fromkeys(str(name) for run in runs for name in run.indexes):
        having = [run.variables[name] for run in runs if name in run.indexes]
        longest = max(having, key=len)
        if longest.dtype.kind in "UO":
            found = dict.fromkeys(text for one in having for text in one.values.tolist())
            labels[name] = Variable((name,), np.array(list(found)), longest.attrs)
        elif all(np.array_equal(longest.values[: len(one)], one.values) for one in having):
            labels[name] = longest
        else:
            unlabelled.add(name)
    return labels, unlabelled


def _aligned(run: Dataset, labels: Mapping[str, Variable], unlabelled: set[str]) -> Dataset:
    """Return a run with named entries in the common order, and without coordinates that differ between runs."""
    for name in unlabelled & {str(name) for name in run.indexes}:
        run = run.assign({f"row_{name}": (name, run[name].values, run[name].attrs)}).drop_vars(name)
    named = {name: values for name, values in labels.items() if values.dtype.kind in "UO" and name in run.indexes}
    return run.reindex(named).chunk()


def _joined(name: str, having: Mapping[Place, Variable], grid: Mapping[str, int], sizes: Mapping[str, int]) -> Variable:
    """Return a variable of all runs that have it: over the grid, or once if it is the same in all and has no time."""
    first = next(iter(having.values()))
    dims = tuple(str(dim) for dim in first.dims)
    if any(variable.dims != first.dims for variable in having.values()):
        raise RunError(f"'{name}' has other dimensions in one run than in another: they do not make one dataset")
    target = tuple(sizes[dim] for dim in dims)
    once = "time" not in dims and all(first.equals(one) for one in having.values())
    complete = once or len(having) == prod(grid.values())
    dtype = np.result_type(*(variable.dtype for variable in having.values()))
    if dtype.kind in "iub" and not (complete and all(variable.shape == target for variable in having.values())):
        dtype = np.dtype(np.float64)
    attributes = _common([variable.attrs for variable in having.values()])
    if once:
        return Variable(dims, _padded(first.data.astype(dtype), target), attributes)
    cells = {place: _padded(variable.data.astype(dtype), target) for place, variable in having.items()}
    for place in product(*map(range, grid.values())):
        if place not in cells:
            cells[place] = _nothing(target, dtype)
    return Variable((*grid, *dims), _stacked(cells, tuple(grid.values())), attributes)


def _nothing(shape: tuple[int, ...], dtype: np.dtype[Any]) -> Any:
    return dask.array.full(shape, "" if dtype.kind in "UO" else np.nan, dtype=dtype, chunks=-1)


def _padded(array: Any, target: tuple[int, ...]) -> Any:
    """Return an array enlarged at the end of each axis."""
    for axis, size in enumerate(target):
        if lacking := size - array.shape[axis]:
            missing = _nothing((*array.shape[:axis], lacking, *array.shape[axis + 1 :]), array.dtype)
            array = dask.array.concatenate([array, missing], axis=axis)
    return array


def _stacked(cells: Mapping[Place, Any], shape: tuple[int, ...], place: Place = ()) -> Any:
    if len(place) == len(shape):
        return cells[place]
    return dask.array.stack([_stacked(cells, shape, (*place, index)) for index in range(shape[len(place)])])


def _common(all_attributes: Sequence[Mapping[Any, Any]]) -> dict[Any, Any]:
    """Return the attributes that are the same in all."""
    first, *others = all_attributes or [{}]
    return {
        key: value
        for key, value in first.items()
        if all(key in other and np.array_equal(other[key], value) for other in others)
    }
