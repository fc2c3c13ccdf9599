"""The options of a mesh."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from dafw.core.options import option


@dataclass
class MeshOptions:
    """How long the sides of the triangles are."""

    wall_size: float = option(16.0, "side of the triangles at the walls of buildings, in metres", above=0.0)
    far_size: float = option(24.0, "side of the triangles far from all walls, in metres", above=0.0)
    transition: float = option(100.0, "distance from a wall at which far_size is reached, in metres", above=0.0)
    across: int = option(
        2, "triangles across a passage, as far as their sides are at least a quarter of wall_size", minimum=1
    )
    max_nodes: int = option(1_000_000, "a mesh that would have more nodes than about this number is refused", minimum=1)


@dataclass
class CoarseMeshOptions:
    """The mesh of the coarser version of a model; null: as ``mesh``. If all are null there is no such version."""

    wall_size: float | None = option(None, "side of the triangles at the walls of buildings, in metres", above=0.0)
    far_size: float | None = option(None, "side of the triangles far from all walls, in metres", above=0.0)
    transition: float | None = option(None, "distance from a wall at which far_size is reached, in metres", above=0.0)
    across: int | None = option(None, "triangles across a passage", minimum=1)

    @property
    def given(self) -> dict[str, Any]:
        """The options that are not null, by name."""
        return {name: value for name, value in asdict(self).items() if value is not None}
