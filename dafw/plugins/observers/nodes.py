"""Readings at the nodes nearest to given points; used by the drone and the stations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dafw.core.ensemble import handed_over
from dafw.core.observation import Selection
from dafw.core.space import Array, StateSpace


def read_nodes(
    space: StateSpace,
    variable: str,
    points: Array,
    sensors: Sequence[str],
    noise_sd: float,
    assumed_variance: float | None,
) -> Selection:
    """Return H in {0, 1} for the nodes nearest to ``points`` (k, 2), each node once, in the order of the points.

    ``sensors`` (k) name the sensor at each point; a node that several are nearest to is read by the first of them.

    The noise of the readings has the standard deviation ``noise_sd``. The filter is given ``assumed_variance``; if that
    is None, the variance of the noise.
    """
    nearest = space[variable].nearest(points).tolist() if len(points) else []
    first: dict[int, str] = {}
    for node, sensor in zip(nearest, sensors, strict=True):
        first.setdefault(node, sensor)
    nodes = np.array(list(first), dtype=np.int64)
    coordinates = space[variable].coordinates
    variance = noise_sd**2 if assumed_variance is None else assumed_variance
    return Selection(
        indices=nodes + space.slice(variable).start,
        covariance=handed_over(np.full(len(nodes), variance)),
        noise_covariance=handed_over(np.full(len(nodes), noise_sd**2)),
        coordinates=np.empty((0, 2)) if coordinates is None or not len(nodes) else coordinates[nodes],
        sensors=tuple(first.values()),
    )
