"""A mesh with the tags of its boundary, as all solvers take it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dafw.core.errors import RequestError

OUTER, WALL = 1, 2
"""Facet tags: the outer rectangle, and the walls of the buildings."""


class MeshError(RequestError):
    """A mesh cannot be made as asked for, or a mesh file cannot be used."""


@dataclass(frozen=True)
class TaggedMesh:
    """A DOLFINx mesh in metres.

    Attributes:
        mesh: the DOLFINx mesh.
        facet_tags: ``OUTER`` or ``WALL`` for every facet of its boundary.
        file: the file that it was read from, if any.
    """

    mesh: Any
    facet_tags: Any
    file: Path | None = None
