"""Flux-corrected transport: Galerkin's step, held within the range of its neighbourhood, with an account of the gas.

Zalesak 1979, doi:10.1016/0021-9991(79)90051-2; Kuzmin 2009, doi:10.1016/j.jcp.2008.12.011, for finite elements: the
fluxes are computed once, from a solution of high order that is already known::

    m_ij   mass matrix, m_i its row sums         dt   time step          f   source
    a_ij   advection and diffusion, for i not j
    d_ij = max(0, a_ij, a_ji)                    the least diffusion that leaves no positive entry off the diagonal
    l_ij = a_ij - d_ij <= 0,  l_jj = o_j - sum_i l_ij     low order; o_j is what leaves through the boundary

1. Galerkin's step from c to g, and one of low order, which is never below zero but too wide:
   m_i (u_i - c_i) / dt + sum_j l_ij u_j = m_i f_i.
2. m_i (g_i - u_i) / dt is a sum of fluxes f_ij = -f_ji from the nodes j to i, with v = g - c - dt f and e = g - u:
   f_ij = m_ij (v_i - v_j) / dt + d_ij (u_i - u_j) + a_ji e_i - a_ij e_j, and of the flux -o_i e_i from outside.
3. They are limited (limiter.py): no node leaves the range that u and c + dt f have in it and in its neighbours.
4. m_i (c'_i - u_i) / dt is the sum of the limited fluxes.

The columns of l add up to o exactly, and fluxes take from one node what they give to another. So the gas balance
holds to round-off, whatever the divergence of the wind. docs/physics.md says more.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dafw.plugins.models.dispersion.fem.sparse_lu import SparseLU
from dafw.plugins.models.dispersion.transport.direct import DirectSystem
from dafw.plugins.models.dispersion.transport.limiter import corrected
from dafw.plugins.models.dispersion.transport.matrices import TransportMatrices
from dafw.plugins.models.dispersion.transport.system import TransportSystem


class FluxCorrectedSystem:
    """The systems of a step in one wind, Galerkin's and that of low order; ``Transport.system`` makes it."""

    def __init__(self, matrices: TransportMatrices, galerkin: TransportSystem | DirectSystem):
        """Prepare the system.

        Args:
            matrices: those of the transport.
            galerkin: the system of Galerkin's step, which nothing else uses.
        """
        self._matrices, self._galerkin = matrices, galerkin
        mass = matrices.before.data * matrices.dt
        self._mass: np.ndarray = np.add.reduceat(mass, matrices.row_starts)
        self._free = np.ones(matrices.nodes, dtype=bool)
        self._free[matrices.fixed] = False
        self._low_order = SparseLU(matrices.elimination)
        self._solve_low = self._low_order.solve
        # The entries of every edge and the numbers of every node that the limiter reads, in its order.
        self._entries = np.tile(mass[matrices.edges.there], (3, 1))
        self._nodal = np.tile(self._mass, (3, 1))

    def change(self, added: np.ndarray, before: Any) -> None:
        """Set the system to that of another wind; the arguments are those of ``TransportSystem.change``."""
        self._galerkin.change(added, before)
        matrices, edges, free = self._matrices, self._matrices.edges, self._free
        operator = added + (matrices.calm - matrices.before.data)
        there, back = operator[edges.there], operator[edges.back]
        self._entries[1:] = matrices.dt * there, matrices.dt * back
        diffusion = np.maximum(np.maximum(there, back), 0.0)
        there, back = there - diffusion, back - diffusion
        leaving = np.zeros(matrices.nodes)
        if matrices.options.outflow == "open":
            leaving[matrices.outer] = np.maximum(matrices.outward(added), 0.0)
        values = np.zeros(operator.size)
        values[edges.there], values[edges.back] = there, back
        values[matrices.diagonal] = self._mass / matrices.dt + leaving - edges.sums(back, there)
        values[matrices.fixed_entries] = 0.0
        values[matrices.fixed_diagonal] = 1.0
        self._low_order.factorise(values)
        # Nodes where the concentration is zero take what their neighbours lose to them.
        taken = -edges.sums(np.where(free[edges.second], 0.0, back), np.where(free[edges.first], 0.0, there))
        self._nodal[1:] = matrices.dt * leaving, matrices.dt * taken

    def step(self, concentration: np.ndarray, source: np.ndarray | None = None) -> np.ndarray:
        """Return the concentration (nodes,) one time step later; arguments and errors are as for ``balanced_step``."""
        return self.balanced_step(concentration, source)[0]

    def gas(self, concentration: np.ndarray) -> float:
        """Return the integral over the site of a concentration (nodes,), in m^2."""
        return float(self._mass @ concentration)

    def balanced_step(self, concentration: np.ndarray, source: np.ndarray | None = None) -> tuple[np.ndarray, float]:
        """Return the concentration (nodes,) one time step later, and the gas in m^2 that left meanwhile.

        The gas inside and the gas that left add up to the gas before and what the source added. With zero concentration
        on the outer boundary, what is there at the start or comes from a source there counts as gas that left.

        Args:
            concentration: (nodes,) at the start of the step.
            source: (nodes,) rate f at the end of the step, in concentration per second; None is no source.

        Raises SolverError if Galerkin's step cannot be solved, and ContractError if an array has another shape.
        """
        matrices, edges = self._matrices, self._matrices.edges
        high = self._galerkin.step(concentration, source)
        # A copy, because for an array that is read-only or has gaps numba would compile the limiter again.
        supplied = concentration.copy() if source is None else concentration + matrices.dt * source
        low = self._solve_low(np.where(self._free, self._mass / matrices.dt * supplied, 0.0))
        return corrected(edges.starts, edges.ends, self._entries, self._nodal, self._free, high, low, supplied)
