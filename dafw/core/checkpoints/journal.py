"""A journal: what was written into a netCDF file, a second time, in a form that a kill cannot damage.

HDF5 has no journal of its own. A process that is killed inside one of its writes may leave a file that does not open,
or one that opens and holds wrong numbers. So each row is also appended to this file, which only ever grows. A
checkpoint knows how long it was; what lies beyond is cut off, and the netCDF file is made anew from the rest.

An entry is a JSON text that says what it is, and arrays; its length and a checksum stand before it. Nothing is pickled.
"""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Self
from zlib import crc32

import numpy as np

from dafw.core.errors import CheckpointError, in_one_line

ROWS, FORECASTS = "rows.journal", "forecasts.journal"
"""The journals of run.nc and of forecast.nc."""
HEAD = struct.Struct("<IQI")
"""Before each entry: the lengths of its text and of its arrays in bytes, and their checksum."""


class Journal:
    """A journal that is being written: a new file, or one that is cut to ``length`` bytes and goes on there."""

    def __init__(self, path: Path, length: int | None = None) -> None:
        self._stream = path.open("wb" if length is None else "r+b")
        if length is not None:
            self._stream.truncate(length)
            self._stream.seek(length)

    def add(self, told: Mapping[str, Any], arrays: Mapping[str, np.ndarray] | None = None) -> None:
        """Append an entry."""
        arrays = {name: np.ascontiguousarray(array) for name, array in (arrays or {}).items()}
        listed = [[name, array.dtype.str, array.shape] for name, array in arrays.items()]
        text = json.dumps({"told": told, "arrays": listed}).encode()
        checksum = crc32(text)
        for array in arrays.values():
            checksum = crc32(array, checksum)
        n_bytes = sum(array.nbytes for array in arrays.values())
        self._stream.writelines([HEAD.pack(len(text), n_bytes, checksum), text, *arrays.values()])

    def length(self) -> int:
        """Return how long the journal is, when all of it is on disk."""
        self._stream.flush()
        os.fsync(self._stream.fileno())
        return self._stream.tell()

    def close(self) -> None:
        """Close the file; raises OSError if what was added last cannot be written."""
        self._stream.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def entries(path: Path, length: int) -> Iterator[tuple[dict[str, Any], dict[str, np.ndarray]]]:
    """Yield the entries in the first ``length`` bytes of a journal: what each is, and its arrays.

    Raises CheckpointError if it is shorter or damaged.
    """
    try:
        with path.open("rb") as stream:
            while stream.tell() < length:
                n_text, n_arrays, checksum = HEAD.unpack(stream.read(HEAD.size))
                if stream.tell() + n_text + n_arrays > length:
                    raise ValueError("an entry is longer than the journal")
                body = stream.read(n_text + n_arrays)
                if len(body) < n_text + n_arrays or crc32(body) != checksum:
                    raise ValueError("an entry has another checksum")
                text = json.loads(body[:n_text])
                arrays, place = {}, n_text
                for name, dtype, shape in text["arrays"]:
                    array = np.frombuffer(body, np.dtype(dtype), int(np.prod(shape, dtype=np.int64)), place)
                    arrays[name] = array.reshape(shape)
                    place += array.nbytes
                yield text["told"], arrays
    except (OSError, ValueError, LookupError, TypeError, RecursionError, MemoryError, struct.error) as error:
        raise CheckpointError(
            f"{path}: is damaged ({type(error).__name__}: {in_one_line(error, longest=200)})"
        ) from error
