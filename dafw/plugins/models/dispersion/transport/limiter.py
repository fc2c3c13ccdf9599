"""Zalesak's limiter on any mesh: how much of each flux lets no node leave a given range.

Zalesak 1979, doi:10.1016/0021-9991(79)90051-2, in the form of Kuzmin 2009, doi:10.1016/j.jcp.2008.12.011::

    f_ij = -f_ji        flux into node i from node j
    P_i+, P_i-          sums of the positive and of the negative fluxes into node i
    Q_i+, Q_i-          what may flow in until node i is at the upper and at the lower end of its range
    R_i+ = min(1, Q_i+ / P_i+), R_i- likewise; both are 1 at nodes whose value is given
    f_ij is multiplied by min(R_i+, R_j-) if it is positive, by min(R_i-, R_j+) if it is negative
"""

from __future__ import annotations

import numpy as np

from dafw.plugins.models.dispersion.transport.edges import Edges


def limited(
    edges: Edges, flux: np.ndarray, outside: np.ndarray, down: np.ndarray, up: np.ndarray, given: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the limited fluxes along the edges (e,), and those through the boundary (n,).

    Args:
        edges: of the mesh.
        flux: (e,) flux into the first node of every edge, out of the second.
        outside: (n,) flux into every node through the boundary.
        down: (n,) the lowest sum of fluxes that a node may receive, zero or less.
        up: (n,) the highest one, zero or more.
        given: indices of nodes that keep their values whatever flows in.
    """
    positive, negative = np.maximum(flux, 0.0), np.minimum(flux, 0.0)
    entering, leaving = np.maximum(outside, 0.0), np.minimum(outside, 0.0)
    rise, fall = edges.sums(positive, -negative) + entering, edges.sums(negative, -positive) + leaving
    may_rise, may_fall = np.ones(up.size), np.ones(up.size)
    np.divide(up, rise, out=may_rise, where=rise > up)
    np.divide(down, fall, out=may_fall, where=fall < down)
    may_rise[given] = may_fall[given] = 1.0
    first, second = edges.first, edges.second
    rising = positive * np.minimum(may_rise[first], may_fall[second])
    falling = negative * np.minimum(may_fall[first], may_rise[second])
    return rising + falling, entering * may_rise + leaving * may_fall
