"""Reduced bases on disk: a folder in the cache for all that defines them, shared by all processes.

    <key>/<digest>.npz     a basis, never changed; the digest is that of its bytes
    <key>/current          the digest of the newest
    <key>/waiting/*.npz    winds that were solved in full and wait to be taken in
    <key>/lock             held by whoever makes or enriches a basis

Everything is written beside and moved into place, so that no reader sees half a file. Where a basis is added, those go
that are not among the newest and were not used for weeks.
"""

from __future__ import annotations

import fcntl
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
from zipfile import BadZipFile

import numpy as np

from dafw.core.errors import ConfigurationError
from dafw.core.making import making
from dafw.plugins.models.dispersion.reduced_wind.basis import ReducedBasis

DIGEST = re.compile("[0-9a-f]{32}")
"""What names a basis."""

log = logging.getLogger(__name__)

NEWEST = 3
"""Bases that stay, however long nobody used them."""
UNUSED = 14 * 24 * 3600.0
"""Seconds since its last use after which an older basis goes: no run lasts so long."""
MOST_WAITING = 200
"""Winds that may wait: enough for several enrichments, and a basis that is full takes in no more."""


@dataclass(frozen=True)
class Waiting:
    """A wind that waits: the file, R and d (2,), its velocity (2 v,)."""

    path: Path
    parameters: np.ndarray
    velocity: np.ndarray


class BasisStore:
    """The bases of one key."""

    def __init__(self, folder: Path):
        self.folder = folder

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the lock, after waiting for whoever has it; a process that dies lets go of it.

        Raises ConfigurationError where the cache cannot be written to.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            file = (self.folder / "lock").open("w")
        except OSError as error:
            raise _unwritable(self.folder, error) from None
        with file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                log.info("reduced basis: waiting for another process that is at work on it")
                fcntl.flock(file, fcntl.LOCK_EX)
            yield

    def content(self, digest: str) -> bytes:
        """Return a basis by name, as it lies on disk; raises ConfigurationError where it is missing or damaged."""
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
                f"wind: the reduced basis {digest} {what} the cache {cache}; leave basis.digest empty for the newest"
            )
        if _digest(content) != digest:
            raise ConfigurationError(f"wind: the reduced basis {path} is damaged; delete it")
        return content

    def load(self, digest: str) -> ReducedBasis:
        """Return a basis by name; raises ConfigurationError where it is missing or damaged."""
        content = self.content(digest)
        path = self.folder / f"{digest}.npz"
        with suppress(OSError):  # a cache that cannot be written to
            os.utime(path, ns=(time.time_ns(), path.stat().st_mtime_ns))
        with np.load(io.BytesIO(content)) as arrays:
            return ReducedBasis(**arrays)

    def newest(self) -> tuple[str, ReducedBasis] | None:
        """Return the newest basis and its digest, None where there is none; where it is damaged, the log says so."""
        try:
            digest = (self.folder / "current").read_text(encoding="utf-8", errors="replace").strip()
            return digest, self.load(digest)
        except FileNotFoundError:
            return None
        except (ConfigurationError, OSError) as error:
            log.warning("reduced basis: it is made anew (%s)", error)
            return None

    def save(self, basis: ReducedBasis) -> str:
        """Write a basis, make it the newest, return its digest; old ones that nobody uses go."""
        content = _packed(**basis.arrays())
        digest = _digest(content)
        _place(self.folder / f"{digest}.npz", content)
        _place(self.folder / "current", digest.encode())
        made = sorted(self.folder.glob("*.npz"), key=lambda path: path.stat().st_mtime_ns)
        for path in made[:-NEWEST]:
            if path.stem != digest and time.time() - path.stat().st_atime > UNUSED:
                path.unlink()
                log.info("reduced basis: %s, not used for %d days, is removed", path, UNUSED / 86400)
        return digest

    def submit(self, reynolds: float, direction: float, velocity: np.ndarray) -> None:
        """Leave a wind (2 v,) for the next basis, unless very many wait already; the log says where it cannot."""
        if len(list((self.folder / "waiting").glob("*.npz"))) >= MOST_WAITING:
            return
        parameters = np.array([reynolds, direction])
        content = _packed(parameters=parameters, velocity=velocity)
        try:
            _place(self.folder / "waiting" / f"{_digest(parameters.tobytes())}.npz", content)
        except ConfigurationError as error:  # the run has its wind and goes on
            log.warning("%s: the next basis will not know a wind that was solved in full", error)

    def waiting(self, size: int, limit: int) -> list[Waiting]:
        """Return up to ``limit`` winds that wait, by name; a file without a velocity of ``size`` numbers is removed."""
        found: list[Waiting] = []
        for path in sorted((self.folder / "waiting").glob("*.npz"))[:limit]:
            try:
                with path.open("rb") as file, np.load(file) as arrays:
                    wind = Waiting(path, arrays["parameters"], arrays["velocity"])
                if wind.parameters.shape != (2,) or wind.velocity.shape != (size,):
                    raise ValueError(f"expected {size} numbers, got shape {wind.velocity.shape}")
            except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
                log.warning("reduced basis: %s cannot be used (%s) and is removed", path, error)
                with suppress(OSError):  # a folder, or another user's
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
    """Write beside and move into place; raises ConfigurationError where the cache cannot be written to."""
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
