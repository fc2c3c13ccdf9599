"""Temporary folders inside a cache. What is made in one is moved to its place in the cache when it is complete.

A process that is killed leaves its folder behind. The next process that makes something removes it, if the process of
that folder no longer runs (which can only be told on the same machine) or if the folder is older than ``OLD``.
"""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

log = logging.getLogger(__name__)

OLD = 3 * 24 * 3600.0
"""Seconds after which a folder counts as left behind, whatever its name says."""


@contextmanager
def making(parent: Path) -> Iterator[Path]:
    """Make a temporary folder in ``parent`` for the block, and remove it afterwards; ``parent`` is made if need be.

    Folders that dead processes left in ``parent`` or one level deeper are removed first. Raises OSError if the folder
    cannot be made.
    """
    parent.mkdir(parents=True, exist_ok=True)
    with suppress(OSError):  # others tidy up at the same time
        for left in filter(_left_behind, [*parent.glob("making-*"), *parent.glob("*/making-*")]):
            shutil.rmtree(left, ignore_errors=True)
            log.info("%s, left behind by a process that was killed, is removed", left)
    with tempfile.TemporaryDirectory(dir=parent, prefix=f"making-{_machine()}-{os.getpid()}-") as folder:
        yield Path(folder)


def _left_behind(folder: Path) -> bool:
    """Return whether the process that made a temporary folder is gone, or the folder is too old to be in use."""
    owner = re.fullmatch(r"making-([0-9a-f]{12})-(\d+)-.*", folder.name)
    if owner is None:
        return False
    if owner[1] == _machine() and not alive(int(owner[2])):
        return True
    try:
        return time.time() - folder.stat().st_mtime > OLD
    except OSError:  # its owner removed it meanwhile
        return False


def alive(process: int) -> bool:
    """Return whether a process exists. One that ended but was not waited for still does."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # it is another user's
        pass
    return True


@cache
def _machine() -> str:
    """Return a name of the machine, its boot and the container: process numbers are unique only within these."""
    parts = [platform.node()]
    with suppress(OSError):
        parts += [Path("/proc/sys/kernel/random/boot_id").read_text(), str(Path("/proc/self/ns/pid").readlink())]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:12]
