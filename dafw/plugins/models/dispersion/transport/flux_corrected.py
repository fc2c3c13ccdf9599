"""Flux-corrected transport: a step that neither undershoots nor overshoots, and keeps account of the gas.

Kuzmin 2009, doi:10.1016/j.jcp.2008.12.011: finite elements, fluxes linearised about the low-order solution. The limiter
is Zalesak's (limiter.py). docs/physics.md says why the form is the conservative one::

    m_i    lumped mass                  m_ij, s_ij   entries of the mass and the stiffness matrix
    k_ij   entries of the advection matrix, the integral of phi_i w . grad phi_j
    a_ij = epsilon s_ij - k_ji          the conservative form of advection and diffusion, for i not j
    d_ij = max(0, a_ij, a_ji)           the smallest diffusion that leaves no positive entry off the diagonal
    l_ij = a_ij - d_ij <= 0             low order
    l_jj = o_j - sum_i l_ij             what leaves a node arrives at others; o_j: what the boundary takes

A step, with dt the time step, c the concentration and f the source:

1. m_i (u_i - c_i) / dt + sum_j l_ij u_j = m_i f_i: low order, never below zero, but too wide;
2. f_ij = m_ij (v_i - v_j) / dt + d_ij (u_i - u_j) with v = u - c - dt f: what low order had added, from node j to i;
3. the fluxes are limited, so that no node leaves the range of u in itself and its neighbours;
4. m_i (c'_i - u_i) / dt = sum_j f_ij, limited.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dafw.core.errors import ContractError, SolverError
from dafw.plugins.models.dispersion.fem.sparse_lu import factorised
from dafw.plugins.models.dispersion.transport.limiter import limited
from dafw.plugins.models.dispersion.transport.matrices import TransportMatrices


class FluxCorrectedSystem:
    """The low-order matrix of a step in one wind, factorised; ``Transport.system`` makes it."""

    def __init__(self, matrices: TransportMatrices):
        self._matrices = matrices
        edges = matrices.edges
        mass = matrices.before.data * matrices.dt
        self._mass = np.add.reduceat(mass, matrices.row_starts)
        self._mass_between = mass[edges.there]
        self._fixed = np.zeros(matrices.nodes, dtype=bool)
        self._fixed[matrices.fixed] = True
        self._diffusion = self._taken = np.zeros(0)
        self._solve: Callable[[np.ndarray], np.ndarray]

    def change(self, advection: np.ndarray, diffusion: float) -> None:
        """Set the system to that of another wind.

        Args:
            advection: (z,) CSR values of the advection matrix of the wind.
            diffusion: coefficient in m^2/s.
        """
        matrices, edges = self._matrices, self._matrices.edges
        spread = diffusion * matrices.stiffness[edges.there]
        there, back = spread - advection[edges.back], spread - advection[edges.there]
        self._diffusion = np.maximum(np.maximum(there, back), 0.0)
        there -= self._diffusion
        back -= self._diffusion
        taken = np.zeros(matrices.nodes)
        if matrices.options.outflow == "open":
            taken[matrices.outer] = np.maximum(matrices.outward(advection), 0.0)
        values = np.zeros(matrices.sparsity.indices.size)
        values[edges.there], values[edges.back] = there, back
        values[matrices.diagonal] = self._mass / matrices.dt + taken - edges.sums(back, there)
        # What fixed nodes take from the others.
        first, second = self._fixed[edges.first], self._fixed[edges.second]
        taken -= edges.sums(np.where(second, back, 0.0), np.where(first, there, 0.0))
        values[matrices.fixed_entries] = 0.0
        values[matrices.fixed_diagonal] = 1.0
        self._taken = taken
        self._solve = factorised(matrices.sparsity, values)

    def step(self, concentration: np.ndarray, source: np.ndarray | None = None) -> np.ndarray:
        """Return the concentration (nodes,) one time step later; the arguments are as for ``balanced_step``."""
        return self.balanced_step(concentration, source)[0]

    def gas(self, concentration: np.ndarray) -> float:
        """Return the integral over the site of a concentration (nodes,), in m^2."""
        return float(self._mass @ concentration)

    def balanced_step(self, concentration: np.ndarray, source: np.ndarray | None = None) -> tuple[np.ndarray, float]:
        """Return the concentration (nodes,) one time step later, and the gas in m^2 that left meanwhile.

        The gas inside and the gas that left add up to the gas before and what the source added. With zero
        concentration on the outer boundary, gas that is there at the start of the step counts as gas that left.

        Args:
            concentration: (nodes,) at the start of the step.
            source: (nodes,) rate f at the end of the step, in concentration per second; None is no source.

        Raises SolverError if a number is not finite, and ContractError if an array has another shape.
        """
        matrices, edges, dt = self._matrices, self._matrices.edges, self._matrices.dt
        for array in (concentration,) if source is None else (concentration, source):
            if array.shape != (matrices.nodes,):
                raise ContractError(f"transport: expected {matrices.nodes} nodal values, got shape {array.shape}")
        supplied = concentration.copy() if source is None else concentration + dt * source
        gone = self._mass[matrices.fixed] @ supplied[matrices.fixed]
        supplied[matrices.fixed] = 0.0
        low = self._solve(self._mass / dt * supplied)
        gone += dt * (self._taken @ low)
        flux, lowest, highest = limited(edges, self._fluxes(low, low - supplied), low, self._mass, matrices.fixed)
        received = edges.sums(flux, -flux)
        gone += received[matrices.fixed].sum()
        received[matrices.fixed] = 0.0
        # The limiter keeps the result in this range; the last bit of its sums may not.
        after = np.clip(low + received / self._mass, lowest, highest)
        if not np.isfinite(gone):
            raise SolverError("transport: the flux-corrected step gave numbers that are not finite")
        return after, float(gone)

    def _fluxes(self, low: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Return the raw antidiffusive fluxes (e,) times the time step, into the first node of every edge.

        Args:
            low: (nodes,) the concentration that the low order gave.
            change: (nodes,) its change in the step, without what the source added.
        """
        edges = self._matrices.edges
        difference = low[edges.first] - low[edges.second]
        flux = self._mass_between * (change[edges.first] - change[edges.second])
        flux += self._matrices.dt * self._diffusion * difference
        return flux
