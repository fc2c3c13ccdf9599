"""The file of a checkpoint: arrays and one JSON text in an ``.npz`` without pickle, so that opening it runs nothing.

A checkpoint is written beside and renamed when it is on disk; the one before is kept. So a kill or a full disk at any
moment leaves one that is whole. A zip file has a checksum for every array: damage is noticed.
"""

from __future__ import annotations

import json
import os
import re
import zipfile
import zlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dafw.core.errors import CheckpointError, in_one_line
from dafw.core.files import atomic_file

FOLDER = "checkpoint"
"""The folder of checkpoints in that of a run; it is removed when the run is complete."""
FORMAT, VERSION = "dafw checkpoint", 1
KEPT = 2
"""How many checkpoints are kept."""
TOLD = "told"
TOLD_OF: Mapping[str, type] = {
    **dict.fromkeys(("configuration", "versions", "pinned", "journals", "summary", "state"), dict),
    "start": str,
    "cycle": int,
}
"""What a checkpoint says at least, and of which type."""
FAILURES = (
    *(OSError, ValueError, LookupError, TypeError, EOFError, zipfile.BadZipFile, RuntimeError),
    *(MemoryError, zlib.error),
)
"""What reading a damaged file may raise."""
NAME = re.compile(r"state-(\d+)\.npz")


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """What a checkpoint holds: plain values, ``told``, and ``arrays`` by name; ``cycle`` counts the cycles done."""

    cycle: int
    told: Mapping[str, Any]
    arrays: Mapping[str, np.ndarray]


def write_checkpoint(folder: Path, checkpoint: Checkpoint) -> int:
    """Write a checkpoint, remove all but the newest ``KEPT``, and return its size in bytes; raises OSError."""
    path = folder / f"state-{checkpoint.cycle:09d}.npz"
    told = {**checkpoint.told, "format": FORMAT, "version": VERSION, "cycle": checkpoint.cycle}
    text = np.frombuffer(json.dumps(told).encode(), dtype=np.uint8)
    with atomic_file(path) as stream, zipfile.ZipFile(stream, "w", allowZip64=True) as file:
        for name, array in {**checkpoint.arrays, TOLD: text}.items():
            with file.open(f"{name}.npy", "w", force_zip64=True) as entry:
                np.lib.format.write_array(entry, array, allow_pickle=False)
    _on_disk(folder)
    for old in checkpoints(folder)[KEPT:]:
        old.unlink(missing_ok=True)
    return path.stat().st_size


def checkpoints(folder: Path) -> list[Path]:
    """Return the files of the checkpoints in a folder, the newest first."""
    found = [(int(name[1]), path) for path in folder.glob("state-*.npz") if (name := NAME.fullmatch(path.name))]
    return [path for _, path in sorted(found, reverse=True)]


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint; raises CheckpointError if it is damaged or of another version."""
    try:
        with zipfile.ZipFile(path) as file:
            arrays = {}
            for entry in file.namelist():
                with file.open(entry) as stream:  # reading an entry to its end checks its checksum
                    arrays[entry.removesuffix(".npy")] = np.lib.format.read_array(stream, allow_pickle=False)
                    if stream.read(1):
                        raise CheckpointError(f"{path}: is damaged ({entry} is longer than its array)")
        told = json.loads(arrays.pop(TOLD).tobytes())
        form, version, cycle = told["format"], told["version"], told["cycle"]
    except FAILURES as error:
        raise CheckpointError(
            f"{path}: is damaged ({type(error).__name__}: {in_one_line(error, longest=200)})"
        ) from error
    if (form, version) != (FORMAT, VERSION):
        raise CheckpointError(f"{path}: is a '{form}' of version {version}, expected '{FORMAT}' of version {VERSION}")
    if wrong := [name for name, kind in TOLD_OF.items() if not isinstance(told.get(name), kind)]:
        raise CheckpointError(f"{path}: is damaged (it does not say its {' and its '.join(wrong)})")
    return Checkpoint(cycle, told, arrays)


def _on_disk(folder: Path) -> None:
    """Write the names of a folder's files to disk, so that a rename outlives a power cut."""
    with suppress(OSError):  # not every system can open a folder
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
