"""A run as a zarr store, cut into chunks that suit how it will be read: maps at a time, or series at a place.

netCDF files are written row by row, so a map is read quickly and a series at a node is read from the whole file. A copy
with other chunks is quick for the other way, and from an object store either is one request a chunk.
"""

from __future__ import annotations

import shutil
import tempfile
from importlib.util import find_spec
from math import prod
from pathlib import Path

from xarray import Dataset, Variable

from dafw.core.errors import RunError

CHUNKS = ("maps", "series")
CHUNK_BYTES = 4 * 2**20
"""Size up to which a chunk grows, before compression."""


def to_zarr(run: Dataset, path: Path, chunks: str = "maps") -> Path:
    """Write a run, or a sweep, into the folder ``path`` and return it; it appears complete or not at all.

    ``chunks``: ``maps``, as many times as fit into ``CHUNK_BYTES`` with all nodes, or ``series``, all times of as many
    nodes. The data are copied piece by piece, so a run may be larger than the memory. Raises RunError if the choice is
    unknown, the folder exists, or zarr (``dafw[zarr]``) is not installed.
    """
    if chunks not in CHUNKS:
        raise RunError(f"chunks must be one of {', '.join(CHUNKS)}, got {chunks!r}")
    if path.exists():
        raise RunError(f"{path}: exists already; nothing was changed")
    if find_spec("zarr") is None:
        raise RunError("to_zarr needs zarr: pip install 'dafw[zarr]'")
    sizes = {str(name): _chunk(variable, chunks) for name, variable in run.variables.items() if variable.ndim}
    pieces = run.drop_encoding()
    for name in run.data_vars:
        if str(name) in sizes:
            pieces[name] = pieces[name].chunk(dict(zip(run[name].dims, sizes[str(name)], strict=True)))
    encoding = {name: {"chunks": size} for name, size in sizes.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    try:
        # Format 2 is what other programs read, too; xarray keeps all metadata of it in one file.
        pieces.to_zarr(beside / "store", encoding=encoding, zarr_format=2, consolidated=True)
        (beside / "store").rename(path)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return path


def _chunk(variable: Variable, chunks: str) -> tuple[int, ...]:
    """Return the size of a chunk along each dimension of a variable."""
    whole = [max(1, size) for size in variable.shape]
    if "time" not in variable.dims:
        return tuple(whole)
    time = variable.dims.index("time")
    others = [place for place in range(variable.ndim) if place != time]
    cut = time if chunks == "maps" or not others else max(others, key=lambda place: whole[place])
    rest = variable.dtype.itemsize * prod(whole[place] for place in range(variable.ndim) if place != cut)
    whole[cut] = min(whole[cut], max(1, CHUNK_BYTES // rest))
    return tuple(whole)
