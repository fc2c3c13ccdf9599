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

from collections.abc import Sequence
from typing import Any

import numpy as np

from dafw.core.errors import SolverError
from dafw.plugins.models.dispersion.transport.limiter import corrected
from dafw.plugins.models.dispersion.transport.low_order import low_order
from dafw.plugins.models.dispersion.transport.march import march
from dafw.plugins.models.dispersion.transport.matrices import TransportMatrices
from dafw.plugins.models.dispersion.transport.predictors import DirectPredictors, IterativePredictors
from dafw.plugins.models.dispersion.transport.system import TransportSystem


class FluxCorrectedSystem:
    """The systems of a step in one wind, Galerkin's and that of low order; ``Transport.system`` makes it."""

    def __init__(self, matrices: TransportMatrices, galerkin: TransportSystem | None):
        """Prepare the system.

        Args:
            matrices: those of the transport.
            galerkin: the system of Galerkin's step, which nothing else uses; None is ``solver: direct``.
        """
        self._matrices = matrices
        mass = matrices.before.data * matrices.dt
        self._mass: np.ndarray = np.add.reduceat(mass, matrices.row_starts)
        self._free = np.ones(matrices.nodes, dtype=bool)
        self._free[matrices.fixed] = False
        lumped = np.where(self._free, self._mass / matrices.dt, 0.0)
        self._predictors = (
            DirectPredictors(matrices, lumped) if galerkin is None else IterativePredictors(matrices, lumped, galerkin)
        )
        # The entries of every edge and the numbers of every node that the limiter reads (limiter.py).
        self._entries, self._nodal = np.zeros((3, matrices.edges.second.size)), np.zeros((3, matrices.nodes))
        self._entries[0], self._nodal[0] = mass[matrices.edges.there], self._mass

    def change(self, added: np.ndarray, before: Any) -> None:
        """Set the system to that of another wind; the arguments are those of ``TransportSystem.change``."""
        matrices, edges = self._matrices, self._matrices.edges
        if matrices.options.outflow == "open":
            self._nodal[1, matrices.outer] = matrices.dt * np.maximum(matrices.outward(added), 0.0)
        operator = matrices.calm - matrices.before.data
        operator += added
        values = low_order(
            edges.starts,
            edges.second,
            edges.there,
            edges.back,
            matrices.diagonal,
            operator,
            matrices.dt,
            self._free,
            self._nodal,
            self._entries,
        )
        self._predictors.change(added, before, values)

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
        after, gone = self.balanced_steps(concentration, [source])
        return after[0], float(gone[0])

    def balanced_steps(
        self, concentration: np.ndarray, sources: Sequence[np.ndarray | None]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the concentrations (steps, nodes) after several steps, and the gas (steps,) that left in each.

        ``sources`` has the source of every step; arguments and errors are as for ``balanced_step``.
        """
        matrices, edges = self._matrices, self._matrices.edges
        for source in sources:
            matrices.require_nodal(concentration, source)
        after, gone = np.empty((len(sources), matrices.nodes)), np.empty(len(sources))
        # Contiguous arrays that may be written to: for others numba would compile its functions again.
        field = np.array(concentration, dtype=np.float64)
        if not isinstance(self._predictors, DirectPredictors):
            for number, source in enumerate(sources):
                supplied = matrices.supplied(field, source).copy()
                high, low = self._predictors.solve(supplied, field, source)
                after[number], gone[number] = corrected(
                    edges.starts, edges.second, self._entries, self._nodal, self._free, high, low, supplied
                )
                field = after[number].copy()
            return after, gone
        without = all(source is None for source in sources)
        nothing = np.zeros(matrices.nodes)
        rates = [] if without else [nothing if source is None else source for source in sources]
        one = self._predictors
        elimination, factors = matrices.elimination, one.factors
        factors.require_valid()
        done = march(
            edges.starts,
            edges.second,
            one.own,
            one.between,
            one.lumped,
            elimination.fill.starts,
            elimination.fill.rows,
            factors.lower,
            factors.upper,
            factors.inverse,
            elimination.places,
            self._entries,
            self._nodal,
            self._free,
            matrices.dt,
            field,
            np.array(rates, dtype=np.float64).reshape(len(rates), matrices.nodes),
            after,
            gone,
        )
        if done < len(sources):
            raise SolverError("transport: a solution is not finite")
        return after, gone
