"""The options of a mesh."""

from __future__ import annotations

from dataclasses import dataclass

from dafw.core.options import option


@dataclass
class MeshOptions:
    """How long the sides of the triangles are."""

    wall_size: float = option(16.0, "m; side of the triangles at the walls of buildings", above=0.0)
    far_size: float = option(24.0, "m; side of the triangles far from any wall", above=0.0)
    transition: float = option(100.0, "m; distance from a wall at which the far size is reached", above=0.0)
    across: int = option(2, "triangles across a passage, with sides of at least a quarter of the wall size", minimum=1)
    max_nodes: int = option(1_000_000, "refuse a mesh that would have more nodes than about this", minimum=1)
