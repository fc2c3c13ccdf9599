"""Files that are there whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from dafw.core.errors import RunError


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file beside ``path``; flush it to disk and rename it where the block ends well, else leave nothing."""
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with beside.open("wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def claim(path: Path) -> None:
    """Make an empty file that was not there; raises RunError where another was quicker."""
    try:
        path.open("x").close()
    except FileExistsError:
        raise RunError(f"{path.parent}: holds a run already; nothing was changed") from None


def write_whole(path: Path, text: str) -> None:
    """Write a text file so that it is there whole or not at all."""
    with whole_file(path) as stream:
        stream.write(text.encode())
