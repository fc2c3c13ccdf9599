"""Applies a function of one row (one time of one run) to all rows, in bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from xarray import DataArray, apply_ufunc

from dafw.core.space import Array

LARGE = 2**27
"""Bytes of an array from which on it is not read at once, but in blocks of rows when the result is used."""


def by_row(
    function: Callable[..., Any],
    arrays: Sequence[DataArray],
    core: Sequence[Sequence[str]],
    result: Sequence[str] = (),
    sizes: dict[str, int] | None = None,
) -> DataArray:
    """Return ``function`` of the arrays' rows: it is given arrays with the ``core`` dimensions, as float64.

    The result of a row has the dimensions ``result``, the new ones among them with the ``sizes``. Arrays of dask, and
    large ones, give an array of dask, which is computed when it is used.
    """
    used = list(arrays)
    if any(array.chunks is None and array.nbytes > LARGE and "time" in array.dims for array in used):
        used = [array.chunk({str(dim): "auto" if dim == "time" else -1 for dim in array.dims}) for array in used]
    known = {str(dim): size for array in used for dim, size in array.sizes.items()} | (sizes or {})
    ends, lengths = tuple(known[dim] for dim in result), [len(dims) for dims in core]

    def all_rows(*blocks: Array) -> Array:
        ends_at = [block.ndim - length for block, length in zip(blocks, lengths, strict=True)]
        lead = np.broadcast_shapes(*(block.shape[:end] for block, end in zip(blocks, ends_at, strict=True)))
        shown = [np.broadcast_to(block, lead + block.shape[end:]) for block, end in zip(blocks, ends_at, strict=True)]
        found = np.empty(lead + ends)
        for place in np.ndindex(lead):
            found[place] = function(*(np.asarray(one[place], dtype=np.float64) for one in shown))
        return found

    computed: DataArray = apply_ufunc(
        all_rows,
        *used,
        input_core_dims=[list(dims) for dims in core],
        output_core_dims=[list(result)],
        dask="parallelized",
        output_dtypes=[np.float64],
        dask_gufunc_kwargs={"allow_rechunk": True, "output_sizes": sizes or {}},
        keep_attrs="drop",
    )
    return computed
