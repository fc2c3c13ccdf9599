"""How much memory a study needs, asked before it begins instead of being ended by the system in the middle."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath

import psutil  # type: ignore[import-untyped]

from dafw.core.errors import ConfigurationError

GROUPS, OWN_GROUPS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
"""Where Linux lists its control groups, which containers and batch systems set limits by, and this process's own."""


def require_memory(wanted: Mapping[str, float]) -> None:
    """Raise ConfigurationError where the bytes that are wanted, by what they are for, exceed what is free.

    The most expensive thing is named.
    """
    total, free = sum(wanted.values()), free_memory()
    if total > free:
        worst = max(wanted, key=lambda name: wanted[name])
        raise ConfigurationError(
            f"the study needs at least {total / 1e9:.3g} GB of memory, there are {free / 1e9:.3g} GB free; "
            f"{wanted[worst] / 1e9:.3g} GB of it for {worst}"
        )


def free_memory() -> float:
    """Return the bytes that this process may still use: of the machine, and of each control group that it is in."""
    return min([float(psutil.virtual_memory().available), *_left_in_groups()])


def _left_in_groups() -> Iterator[float]:
    """Give what the limits of the process's control groups leave of memory, where there are limits.

    What a group uses includes files that are kept in memory for no other reason than that there was room.
    """
    for folder, limit, used, files in _groups():
        with suppress(OSError, ValueError):  # no limit is the word "max", and the topmost group has no files
            most = int((folder / limit).read_text())
            stat = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
            yield max(0.0, float(most - int((folder / used).read_text()) + int(stat.get(files, 0))))


def _groups() -> Iterator[tuple[Path, str, str, str]]:
    """Give the folders of the process's control groups and of those around them, and the names of what is read there.

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
