"""Zalesak's limiter on any mesh: how much of each flux lets no node leave the range of its neighbourhood.

Zalesak 1979, doi:10.1016/0021-9991(79)90051-2, in the form for finite elements of Kuzmin 2009,
doi:10.1016/j.jcp.2008.12.011::

    f_ij = -f_ji        raw flux into node i from node j
    P_i+ , P_i-         sums of the positive, of the negative fluxes into node i
    Q_i+ , Q_i-         what may flow in until node i has the highest (lowest) value of itself and its neighbours
    R_i+ = min(1, Q_i+ / P_i+), R_i- likewise; 1 at nodes whose value is given
    f_ij is multiplied by min(R_i+, R_j-) if it is positive, by min(R_i-, R_j+) if it is negative
"""

from __future__ import annotations

import numpy as np

from dafw.plugins.models.dispersion.transport.edges import Edges


def limited(
    edges: Edges, flux: np.ndarray, values: np.ndarray, mass: np.ndarray, given: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the limited fluxes (e,), and the lowest and the highest value (n,) around every node.

    Args:
        edges: of the mesh.
        flux: (e,) raw flux into the first node of every edge, out of the second.
        values: (n,) at the nodes, to which the fluxes will be added.
        mass: (n,) by which the sum of fluxes into a node is divided there.
        given: indices of nodes that keep their values whatever flows in.
    """
    lowest, highest = edges.range(values)
    up, down = np.maximum(flux, 0.0), np.minimum(flux, 0.0)
    rise = edges.sums(up, -down)
    fall = edges.sums(down, -up)
    with np.errstate(divide="ignore", invalid="ignore"):
        may_rise = np.where(rise > 0.0, np.minimum(1.0, mass * (highest - values) / rise), 1.0)
        may_fall = np.where(fall < 0.0, np.minimum(1.0, mass * (lowest - values) / fall), 1.0)
    may_rise[given] = may_fall[given] = 1.0
    part_up = np.minimum(may_rise[edges.first], may_fall[edges.second])
    part_down = np.minimum(may_fall[edges.first], may_rise[edges.second])
    return up * part_up + down * part_down, lowest, highest
