"""Files that appear complete or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from dafw.core.errors import RunError

if TYPE_CHECKING:
    from xarray import Dataset


@contextmanager
def atomic_file(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file beside ``path``. If the block succeeds, write it to disk and rename it; else remove it."""
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with beside.open("wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def made_anew(path: Path) -> Path:
    """Return the name beside ``path`` under which a file is made that is to take its place.

    What a process that was killed left there is removed.
    """
    beside = path.with_name(f".{path.name}.part")
    beside.unlink(missing_ok=True)
    return beside


def claim(path: Path) -> None:
    """Create an empty file; raises RunError if it exists already."""
    try:
        path.open("x").close()
    except FileExistsError:
        raise RunError(f"{path.parent}: holds a run already; nothing was changed") from None


def write_dataset(path: Path, dataset: Dataset) -> None:
    """Write netCDF-4; readers see the old file or the new one, never a part.

    The conventions are CF's, so the coordinates of dimensions get no number that means a missing one.
    """
    named = dataset.assign_attrs({"Conventions": "CF-1.11", **dataset.attrs})
    filled = {name: {"_FillValue": None} for name in dataset.dims if name in dataset.variables}
    with atomic_file(path) as stream:
        named.to_netcdf(stream.name, format="NETCDF4", engine="netcdf4", encoding=filled)


def write_atomically(path: Path, text: str) -> None:
    """Write a text file; readers see the old file or the new one, never a part."""
    with atomic_file(path) as stream:
        stream.write(text.encode())
