"""Folders of a cache in which something is being made, to be moved into place when it is whole.

A process that is killed leaves its folder behind. Whoever makes something next removes it: where its process is gone,
which only the machine tells on which it ran, or where it is older than anything takes to make.
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
"""Seconds after which a folder is nobody's, whoever it says it belongs to."""


@contextmanager
def making(parent: Path) -> Iterator[Path]:
    """Give a folder in ``parent``, which is made, too; gone when the block ends.

    So is what dead processes left there and one folder deeper. Raises OSError where the folder cannot be made.
    """
    parent.mkdir(parents=True, exist_ok=True)
    with suppress(OSError):  # others tidy up at the same time
        for left in filter(_nobodys, [*parent.glob("making-*"), *parent.glob("*/making-*")]):
            shutil.rmtree(left, ignore_errors=True)
            log.info("%s, left behind by a process that was killed, is removed", left)
    with tempfile.TemporaryDirectory(dir=parent, prefix=f"making-{_machine()}-{os.getpid()}-") as folder:
        yield Path(folder)


def _nobodys(folder: Path) -> bool:
    owner = re.fullmatch(r"making-([0-9a-f]{12})-(\d+)-.*", folder.name)
    if owner is None:
        return False
    if owner[1] == _machine() and not alive(int(owner[2])):
        return True
    try:
        return time.time() - folder.stat().st_mtime > OLD
    except OSError:  # its owner was quicker
        return False


def alive(process: int) -> bool:
    """Say whether a process is there; one that ended and was not waited for still is."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # it is another user's
        pass
    return True


@cache
def _machine() -> str:
    """Name the machine, its start, and the container: all of them number their processes for themselves."""
    parts = [platform.node()]
    with suppress(OSError):
        parts += [Path("/proc/sys/kernel/random/boot_id").read_text(), str(Path("/proc/self/ns/pid").readlink())]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:12]
