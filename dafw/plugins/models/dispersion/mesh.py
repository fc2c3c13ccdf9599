"""The triangle mesh of a site: gmsh makes it, DOLFINx reads it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

OUTER, WALL = 1, 2
"""Facet tags: the outer rectangle, and the walls of the buildings."""


@dataclass(frozen=True)
class TaggedMesh:
    """A DOLFINx mesh in metres with its boundary facets tagged ``OUTER`` or ``WALL``."""

    mesh: Any
    facet_tags: Any
