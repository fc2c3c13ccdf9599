"""Where the unknowns of a divided mesh stand in the numbering of the same mesh when one process holds it."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from dafw.plugins.models.dispersion.fem.mixed_space import MixedSpace


def nearest(points: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the index (n,) of the point that is nearest to each place.

    Args:
        points: (m, d) points among which to search, in m.
        places: (n, d) places for which to search, in m.
    """
    found: np.ndarray = KDTree(points).query(places)[1]
    return found


def places_of(divided: MixedSpace, undivided: MixedSpace) -> np.ndarray:
    """Return the index (n,) in ``undivided`` of every unknown of ``divided`` that this rank owns."""
    pairs = (
        (undivided.velocity_space, divided.velocity_space),
        (undivided.pressure_space, divided.pressure_space),
    )
    velocity, pressure = (nearest(*(space.tabulate_dof_coordinates() for space in pair)) for pair in pairs)
    places = np.empty(divided.unknowns, dtype=np.int64)
    nodes = velocity[: divided.velocity_dofs.size // 2]
    places[divided.velocity_dofs] = undivided.velocity_dofs.reshape(-1, 2)[nodes].ravel()
    places[divided.pressure_dofs] = undivided.pressure_dofs[pressure[: divided.pressure_dofs.size]]
    return places
