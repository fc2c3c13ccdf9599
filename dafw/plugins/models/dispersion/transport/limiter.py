"""The fluxes of flux-corrected transport and Zalesak's limiter: how much of each flux lets no node leave its range.

Zalesak 1979, doi:10.1016/0021-9991(79)90051-2, in the form of Kuzmin 2009, doi:10.1016/j.jcp.2008.12.011. Symbols and
fluxes are those of flux_corrected.py::

    f_ij = -f_ji        flux into node i from node j, times the time step
    P_i+, P_i-          sums of the positive and of the negative fluxes into node i
    Q_i+, Q_i-          what may flow in until node i is at the upper and at the lower end of its range
    R_i+ = min(1, Q_i+ / P_i+), R_i- likewise; both are 1 at nodes whose value is given
    f_ij is multiplied by min(R_i+, R_j-) if it is positive, by min(R_i-, R_j+) if it is negative

The loops are compiled by numba (without its fast mathematics, so that the bits do not depend on the processor). Most of
their time is reading, so a loop over the edges does all that it can with the numbers that it reads, and without
branches. Figures are in docs/fast-winds.md, "Re-runs".
"""

from __future__ import annotations

import numpy as np
from numba import njit

NOTHING = np.finfo(float).tiny
"""Least sum of fluxes to divide by: where nothing flows, nothing has to be limited."""


@njit(cache=True)
def corrected(
    starts: np.ndarray,
    second: np.ndarray,
    entries: np.ndarray,
    nodal: np.ndarray,
    free: np.ndarray,
    high: np.ndarray,
    low: np.ndarray,
    supplied: np.ndarray,
) -> tuple[np.ndarray, float]:
    """Return the concentration (n,) at the end of a step, and the gas in m^2 that left meanwhile.

    Args:
        starts: (n + 1,) node i is the first one of the edges from ``starts[i]`` to before ``starts[i + 1]``.
        second: (e,) the second node of every edge.
        entries: (3, e) for every edge, with i its first node and j its second: m_ij, dt a_ij, dt a_ji.
        nodal: (3, n) for every node: mass m_i; what leaves it through the boundary in a step, as a multiple of its
            concentration: dt o_i; and to nodes whose value is given, likewise.
        free: (n,) False at nodes whose value is given, bool.
        high: (n,) Galerkin's concentration at the end of the step.
        low: (n,) that of low order.
        supplied: (n,) that at the start, with what the source adds in the step.
    """
    flux, rise, fall, lowest, highest = fluxes(starts, second, entries, nodal[1], high, low, supplied)
    n = low.size
    may_rise, may_fall, received, after = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    gone = 0.0
    for i in range(n):
        up, down = nodal[0, i] * (highest[i] - low[i]), nodal[0, i] * (lowest[i] - low[i])
        may_rise[i] = up / max(up, rise[i], NOTHING) if free[i] else 1.0
        may_fall[i] = down / min(down, fall[i], -NOTHING) if free[i] else 1.0
        outside = nodal[1, i] * (low[i] - high[i])
        received[i] = max(outside, 0.0) * may_rise[i] + min(outside, 0.0) * may_fall[i]
        gone += (nodal[1, i] + nodal[2, i]) * low[i] - received[i]
    exchange(starts, second, flux, may_rise, may_fall, received)
    for i in range(n):
        if not free[i]:
            gone += nodal[0, i] * supplied[i] + received[i]
            received[i] = 0.0
        # The limiter keeps the result in this range; the last bit of its sums may not.
        after[i] = min(max(low[i] + received[i] / nodal[0, i], lowest[i]), highest[i])
    return after, gone


@njit(cache=True)
def fluxes(
    starts: np.ndarray,
    second: np.ndarray,
    entries: np.ndarray,
    leaving: np.ndarray,
    high: np.ndarray,
    low: np.ndarray,
    supplied: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the fluxes (e,), their sums P+ and P-, and the lowest and the highest value of every range, (n,) each.

    The arguments are those of ``corrected``; ``leaving`` (n,) is dt o_i.
    """
    n = low.size
    change, excess, least, most = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    rise, fall, lowest, highest, flux = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(second.size)
    for i in range(n):
        change[i], excess[i] = high[i] - supplied[i], high[i] - low[i]
        least[i] = lowest[i] = min(low[i], supplied[i])
        most[i] = highest[i] = max(low[i], supplied[i])
        outside = leaving[i] * (low[i] - high[i])
        rise[i], fall[i] = max(outside, 0.0), min(outside, 0.0)
    for i in range(n):
        # In variables of their own, which stay in registers: a tenth quicker.
        change_i, excess_i, low_i, least_i, most_i = change[i], excess[i], low[i], least[i], most[i]
        rise_i, fall_i, lowest_i, highest_i = rise[i], fall[i], lowest[i], highest[i]
        for edge in range(starts[i], starts[i + 1]):
            j, there, back = second[edge], entries[1, edge], entries[2, edge]
            spread = max(there, back, 0.0) * (low_i - low[j])
            f = entries[0, edge] * (change_i - change[j]) + (spread + (back * excess_i - there * excess[j]))
            flux[edge] = f
            positive, negative = max(f, 0.0), min(f, 0.0)
            rise_i += positive
            fall_i += negative
            rise[j] -= negative
            fall[j] -= positive
            lowest_i, highest_i = min(lowest_i, least[j]), max(highest_i, most[j])
            lowest[j], highest[j] = min(lowest[j], least_i), max(highest[j], most_i)
        rise[i], fall[i], lowest[i], highest[i] = rise_i, fall_i, lowest_i, highest_i
    return flux, rise, fall, lowest, highest


@njit(cache=True)
def exchange(
    starts: np.ndarray,
    second: np.ndarray,
    flux: np.ndarray,
    may_rise: np.ndarray,
    may_fall: np.ndarray,
    received: np.ndarray,
) -> None:
    """Add the limited fluxes to what every node receives.

    Args:
        starts: as for ``corrected``.
        second: as for ``corrected``.
        flux: (e,) flux into the first node of every edge, out of the second.
        may_rise: (n,) R+.
        may_fall: (n,) R-.
        received: (n,) is added to.
    """
    for i in range(received.size):
        may_rise_i, may_fall_i, received_i = may_rise[i], may_fall[i], received[i]
        for edge in range(starts[i], starts[i + 1]):
            j = second[edge]
            f = max(flux[edge], 0.0) * min(may_rise_i, may_fall[j])
            f += min(flux[edge], 0.0) * min(may_fall_i, may_rise[j])
            received_i += f
            received[j] -= f
        received[i] = received_i
