"""Checks before a study begins that it fits in memory, so that the system does not kill it halfway."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath

import psutil

from dafw.core.errors import ConfigurationError

GROUPS, OWN_GROUPS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
"""Files in which Linux lists control groups (the memory limits of containers and batch systems), and this process's."""


def require_memory(wanted: Mapping[str, float]) -> None:
    """Raise ConfigurationError if the ``wanted`` bytes, keyed by their purpose, exceed the free memory.

    The message names the largest of them.
    """
    total, free = sum(wanted.values()), free_memory()
    if total > free:
        worst = max(wanted, key=lambda name: wanted[name])
        raise ConfigurationError(
            f"the study needs at least {total / 1e9:.3g} GB of memory, there are {free / 1e9:.3g} GB free; "
            f"{wanted[worst] / 1e9:.3g} GB of it for {worst}"
        )


def free_memory() -> float:
    """Return the bytes that this process may still use: the least of what the machine and its control groups leave."""
    return min([float(psutil.virtual_memory().available), *_left_in_groups()])


def _left_in_groups() -> Iterator[float]:
    """Yield the bytes that each control group of the process still has below its memory limit, if it has one.

    The reported use of a group includes cached files, which the kernel drops when memory is needed; they do not count.
    """
    for folder, limit, used, files in _groups():
        with suppress(OSError, ValueError):  # without a limit the file says "max"; the root group has no such files
            most = int((folder / limit).read_text())
            stat = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
            yield max(0.0, float(most - int((folder / used).read_text()) + int(stat.get(files, 0))))


def _groups() -> Iterator[tuple[Path, str, str, str]]:
    """Yield the folders of the process's control groups and of their parents, with the names of the files to read.

    There are two versions of control groups: https://docs.kernel.org/admin-guide/cgroup-v2.html and
    https://docs.kernel.org/admin-guide/cgroup-v1/memory.html.
    """
    try:
        lines = OWN_GROUPS.read_text().splitlines()
    except OSError:  # not Linux
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if not controllers:
            root, names = GROUPS, ("memory.max", "memory.current", "inactive_file")
        elif "memory" in controllers.split(","):
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
            root = GROUPS / "memory"
        else:
            continue
        relative = PurePosixPath(path.lstrip("/"))
        for group in (relative, *relative.parents):
            yield (root / group, *names)
