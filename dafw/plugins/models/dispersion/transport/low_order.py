"""Discrete upwinding: the matrix of low order of flux-corrected transport, made from Galerkin's entry by entry.

Kuzmin 2009, doi:10.1016/j.jcp.2008.12.011; the symbols are those of flux_corrected.py. Compiled by numba: with NumPy a
new wind takes a quarter longer.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def low_order(
    starts: np.ndarray,
    second: np.ndarray,
    there: np.ndarray,
    back: np.ndarray,
    diagonal: np.ndarray,
    operator: np.ndarray,
    dt: float,
    free: np.ndarray,
    nodal: np.ndarray,
    entries: np.ndarray,
) -> np.ndarray:
    """Return the CSR values (z,) of the matrix of low order.

    Args:
        starts: (n + 1,) ``starts``, ``second``, ``there`` and ``back`` are those of ``Edges``.
        second: (e,)
        there: (e,)
        back: (e,)
        diagonal: (n,) index of the diagonal entry of every row.
        operator: (z,) CSR values of a_ij: Galerkin's matrix without that of the mass.
        dt: time step in s.
        free: (n,) False at nodes where the concentration is zero, bool.
        nodal: (3, n) for every node m_i, dt o_i, and dt times what leaves it to nodes that are not free, as a multiple
            of its concentration. The last is overwritten.
        entries: (3, e) for every edge m_ij, dt a_ij, dt a_ji. The last two are overwritten.
    """
    n = free.size
    values = np.zeros(operator.size)
    for i in range(n):
        values[diagonal[i]] = (nodal[0, i] + nodal[1, i]) / dt
        nodal[2, i] = 0.0
    for i in range(n):
        for edge in range(starts[i], starts[i + 1]):
            j, a_ij, a_ji = second[edge], operator[there[edge]], operator[back[edge]]
            entries[1, edge], entries[2, edge] = dt * a_ij, dt * a_ji
            diffusion = max(a_ij, a_ji, 0.0)
            l_ij, l_ji = a_ij - diffusion, a_ji - diffusion
            # Columns, not rows, add up: what leaves a node arrives at its neighbours.
            values[diagonal[j]] -= l_ij
            values[diagonal[i]] -= l_ji
            if free[i] and free[j]:
                values[there[edge]], values[back[edge]] = l_ij, l_ji
            elif free[i]:
                nodal[2, i] -= dt * l_ji
            elif free[j]:
                nodal[2, j] -= dt * l_ij
    for i in range(n):
        if not free[i]:
            values[diagonal[i]] = 1.0
    return values
