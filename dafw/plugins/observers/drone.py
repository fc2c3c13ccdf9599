"""The drone: reads the mesh nodes nearest to points along its path.

The leg of a step is sampled at equal distances. Its end is a sample; its start is not, because the step before read
it. Each sample reads the nearest node. Two samples a step give the one or two nodes a second of Gioia et al. (2024),
Sec. III.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import accumulate, pairwise, starmap
from math import dist

import numpy as np

from dafw.core.ensemble import Route
from dafw.core.interfaces import Observer
from dafw.core.observation import ObservationOperator
from dafw.core.options import option
from dafw.core.space import Array, StateSpace
from dafw.plugins.observers.nodes import read_nodes


def along(path: Array, n_samples: int) -> Array:
    """Return ``n_samples`` points (n, 2) at equal distances along the polyline (k, 2), with its end, without its start.

    For a vehicle that hovers it is the one point where the vehicle is.
    """
    # For so few points plain numbers are faster than arrays: they save 0.06 of the 1 ms that a cycle takes outside of
    # model and filter. The bits are those of numpy.interp.
    corners = path.tolist()
    travelled = [0.0, *accumulate(starmap(dist, pairwise(corners)))]
    if travelled[-1] == 0.0:
        return path[:1]
    points = []
    for number in range(1, n_samples + 1):
        station = number / n_samples * travelled[-1]
        leg = bisect_right(travelled, station) - 1
        beyond = station - travelled[leg]
        if beyond == 0.0:
            points.append(corners[leg])
            continue
        length = travelled[leg + 1] - travelled[leg]
        points.append(
            [(end - begin) / length * beyond + begin for begin, end in zip(*corners[leg : leg + 2], strict=True)]
        )
    return np.array(points)


@dataclass
class Drone(Observer):
    """Reads a variable along the flown leg of every vehicle."""

    samples: int = option(2, "samples along the leg of a step; those with the same nearest node count once", minimum=1)
    variable: str = option("concentration", "state variable that is read; it needs coordinates")
    noise_sd: float = option(1e-3, "standard deviation of the readings' noise", above=0.0)
    assumed_variance: float | None = option(None, "error variance for the filter; null: noise_sd squared", above=0.0)

    def suit(self, space: StateSpace, dt: float) -> None:
        """Raise ConfigurationError if the variable does not exist or has no coordinates in the plane."""
        self.require_places(space, self.variable)

    def operator(self, space: StateSpace, route: Route, t: float) -> ObservationOperator:
        """Return the readings of all vehicles on this leg."""
        points = [along(path, self.samples) for path in route.paths]
        joined = np.concatenate(points) if points else np.empty((0, 2))
        sensors = [f"drone {number}" for number, part in enumerate(points) for _ in part]
        return read_nodes(space, self.variable, joined, sensors, self.noise_sd, self.assumed_variance)
