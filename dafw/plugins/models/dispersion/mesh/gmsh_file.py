"""gmsh as this package uses it, and the checksum at the end of a mesh file."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import gmsh

from dafw.plugins.models.dispersion.mesh.tagged import MeshError


@contextmanager
def gmsh_session() -> Iterator[None]:
    """Provide gmsh with a fresh model, and leave it afterwards as it was before.

    It is quiet, uses one thread, reads no start-up files and installs no signal handlers. Raises MeshError if gmsh
    fails inside the block.
    """
    running = bool(gmsh.isInitialized())
    if not running:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        for source in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
            gmsh.option.setNumber(f"Mesh.MeshSize{source}", 0)
        gmsh.option.setNumber("Mesh.LcIntegrationPrecision", 1e-3)
        gmsh.option.setNumber("Mesh.Algorithm", 6)
        gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
        gmsh.model.add("dafw")
        yield
    except Exception as error:
        # gmsh raises plain Exception; an error of a subclass comes from elsewhere
        if type(error) is not Exception:
            raise
        raise MeshError(f"mesh: gmsh failed ({error})") from None
    finally:
        if running:
            gmsh.model.remove()
        else:
            gmsh.finalize()


def checksum_section(content: bytes) -> bytes:
    """Return a closing section for a mesh file that holds the checksum of what precedes; gmsh ignores it."""
    return f"$Comments\nsha256 {hashlib.sha256(content).hexdigest()}\n$EndComments\n".encode()


def is_intact(path: Path) -> bool:
    """Say whether a mesh file ends in the checksum of its content."""
    stored = path.read_bytes()
    content, mark, _ = stored.rpartition(b"$Comments\n")
    return bool(mark) and stored == content + checksum_section(content)
