"""Reduced bases on disk: one folder in the cache for everything that defines a basis, shared by all processes.

    <key>/<digest>.npz     a basis, which never changes; its name is the digest of its bytes
    <key>/made             the digest of the basis as it was made
    <key>/enriched         the digest of the newest basis to which winds were added
    <key>/waiting/*.npz    winds that were solved in full and wait to be added
    <key>/lock             held by the process that makes or enriches a basis

Every file is written elsewhere first and then moved into place, so that no reader sees a part of a file. When a basis
is saved, old ones that were not used for weeks are removed.
"""

from __future__ import annotations

import hashlib
import io
import logging
import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from zipfile import BadZipFile

import numpy as np
from filelock import FileLock, Timeout

from dafw.core.errors import ConfigurationError
from dafw.core.making import making
from dafw.plugins.models.dispersion.reduced_wind.basis import ReducedBasis

Role = Literal["made", "enriched"]

DIGEST = re.compile("[0-9a-f]{32}")

log = logging.getLogger(__name__)

NEWEST = 3
"""Number of the newest bases that are never removed."""
UNUSED = 14 * 24 * 3600.0
"""Seconds since its last use after which an older basis is removed; no run takes so long."""
MOST_WAITING = 200
"""Number of winds that may wait; that is enough to enrich a basis several times."""


@dataclass(frozen=True)
class Waiting:
    """A wind that waits to be added to a basis.

    Attributes:
        path: its file.
        parameters: (2,) unit Reynolds number in 1/m and direction in radians.
        velocity: (2 m,) velocity of the unit wind.
    """

    path: Path
    parameters: np.ndarray
    velocity: np.ndarray


class BasisStore:
    """The bases of one key."""

    def __init__(self, folder: Path):
        self.folder = folder

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the lock inside the block; wait first if another process has it. A process that dies releases it.

        Raises ConfigurationError if the cache cannot be written to.
        """
        lock = FileLock(self.folder / "lock")
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            try:
                lock.acquire(timeout=0)
            except Timeout:
                log.info("reduced basis: waiting for another process, which makes or enriches it")
                lock.acquire()
        except OSError as error:
            raise _unwritable(self.folder, error) from None
        try:
            yield
        finally:
            lock.release()

    def content(self, digest: str) -> bytes:
        """Return the bytes of the basis with a digest; raises ConfigurationError if it is missing or damaged."""
        path, cache = self.folder / f"{digest}.npz", self.folder.parent
        try:
            content = path.read_bytes() if DIGEST.fullmatch(digest) else None
        except (FileNotFoundError, NotADirectoryError):
            content = None
        except OSError as error:
            raise ConfigurationError(f"wind: the reduced basis {path} cannot be read ({error.strerror})") from None
        if content is None:
            others = DIGEST.fullmatch(digest) and any(cache.glob(f"*/{digest}.npz"))
            what = "is one of another mesh or of other wind options in" if others else "is not in"
            raise ConfigurationError(
                f"wind: the reduced basis {digest} {what} the cache {cache}; leave basis.digest empty to make a new one"
            )
        if _digest(content) != digest:
            raise ConfigurationError(f"wind: the reduced basis {path} is damaged; delete it")
        return content

    def load(self, digest: str) -> ReducedBasis:
        """Return the basis with a digest; raises ConfigurationError if it is missing or damaged."""
        content = self.content(digest)
        path = self.folder / f"{digest}.npz"
        with suppress(OSError):  # the cache may not be writable
            os.utime(path, ns=(time.time_ns(), path.stat().st_mtime_ns))
        with np.load(io.BytesIO(content)) as arrays:
            return ReducedBasis(**arrays)

    def find(self, role: Role) -> tuple[str, ReducedBasis] | None:
        """Return the digest and the basis of a role.

        None if there is none, or if it is damaged, which the log then says.
        """
        try:
            digest = (self.folder / role).read_text(encoding="utf-8", errors="replace").strip()
            return digest, self.load(digest)
        except FileNotFoundError:
            return None
        except (ConfigurationError, OSError) as error:
            log.warning("reduced basis: it is made anew (%s)", error)
            return None

    def save(self, basis: ReducedBasis, role: Role) -> str:
        """Write a basis, give it a role, return its digest; remove old bases that nobody uses."""
        content = _packed(**basis.arrays())
        digest = _digest(content)
        _place(self.folder / f"{digest}.npz", content)
        _place(self.folder / role, digest.encode())
        self._remove_unused()
        return digest

    def _remove_unused(self) -> None:
        with_role = set()
        for role in ("made", "enriched"):
            with suppress(OSError):
                with_role.add((self.folder / role).read_text(encoding="utf-8", errors="replace").strip())
        saved = sorted(self.folder.glob("*.npz"), key=lambda path: path.stat().st_mtime_ns)
        for path in saved[:-NEWEST]:
            if path.stem not in with_role and time.time() - path.stat().st_atime > UNUSED:
                path.unlink()
                log.info("reduced basis: %s, not used for %d days, is removed", path, UNUSED / 86400)

    def submit(self, reynolds: float, direction: float, velocity: np.ndarray) -> None:
        """Leave a wind for the next enriched basis, unless ``MOST_WAITING`` wait already.

        If it cannot be written, the log says so and the run continues.

        Args:
            reynolds: unit Reynolds number in 1/m.
            direction: towards which the air moves, in radians.
            velocity: (2 m,) velocity of the unit wind.
        """
        if len(list((self.folder / "waiting").glob("*.npz"))) >= MOST_WAITING:
            return
        parameters = np.array([reynolds, direction])
        content = _packed(parameters=parameters, velocity=velocity)
        try:
            _place(self.folder / "waiting" / f"{_digest(parameters.tobytes())}.npz", content)
        except ConfigurationError as error:
            log.warning("%s: a wind that was solved in full is not kept for the next basis", error)

    def waiting(self, size: int, limit: int) -> list[Waiting]:
        """Return up to ``limit`` winds that wait, in the order of their names.

        Files that do not hold a velocity of ``size`` numbers are removed, with a line in the log.
        """
        found: list[Waiting] = []
        for path in sorted((self.folder / "waiting").glob("*.npz"))[:limit]:
            try:
                with path.open("rb") as file, np.load(file) as arrays:
                    wind = Waiting(path, arrays["parameters"], arrays["velocity"])
                if wind.parameters.shape != (2,) or wind.velocity.shape != (size,):
                    raise ValueError(f"expected {size} numbers, got shape {wind.velocity.shape}")
            except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
                log.warning("reduced basis: %s cannot be used (%s) and is removed", path, error)
                with suppress(OSError):  # a folder, or another user's file
                    path.unlink()
                continue
            found.append(wind)
        return found


@dataclass(frozen=True)
class StoredBasis:
    """A basis in use, its digest, and the store that it comes from."""

    store: BasisStore
    digest: str
    basis: ReducedBasis


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]


def _packed(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **arrays)
    return file.getvalue()


def _place(path: Path, content: bytes) -> None:
    """Write a file elsewhere and move it into place; raises ConfigurationError if the cache cannot be written to."""
    try:
        with making(path.parent) as folder:
            made = folder / path.name
            with made.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            made.replace(path)
    except OSError as error:
        raise _unwritable(path.parent, error) from None


def _unwritable(folder: Path, error: OSError) -> ConfigurationError:
    return ConfigurationError(f"wind: cannot write to the cache {folder} ({error.strerror}); DAFW_CACHE moves it")
