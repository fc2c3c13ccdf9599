"""Steps of the transport in one wind: iterated with a preconditioner that suits the wind, or solved directly."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dafw.core.errors import ContractError, SolverError

if TYPE_CHECKING:
    from dafw.plugins.models.dispersion.transport import Transport

BOUNDS = (2.5, 12.0)
"""A wind is beyond a bound where the entries beside the diagonal add up to so many times it in one row of twenty.

Up to the first, ILU without fill is made sooner and as good. Up to the second, BiCGStab with ILU(1) mostly takes ten
iterations or fewer; not far above it fails, and a sparse LU is quicker.
"""


def strength(transport: Transport, after: np.ndarray) -> int:
    """Say how many bounds the wind of a matrix (CSR values) is beyond: by the matrix alone, and alike on all ranks."""
    from dafw.plugins.models.dispersion.sparsity import total

    absolute = np.abs(after)
    diagonal, whole = absolute[transport.diagonal], np.add.reduceat(absolute, transport.row_starts)
    counts = [np.count_nonzero(whole > (1.0 + bound) * diagonal) for bound in BOUNDS]
    *counts, nodes = total(transport.sparsity.comm, np.array([*counts, transport.nodes])).tolist()
    return sum(20 * rows > nodes for rows in counts)


class TransportSystem:
    """Steps of the transport in one wind, its matrix and preconditioner kept: made by ``Transport.system``.

    Attributes:
        strength: how many of the bounds its wind is beyond; the fill of its factorisation, or a direct solution.
    """

    def __init__(self, transport: Transport):
        self._transport = transport
        self._values = np.zeros(transport.indices.size)
        self.strength = 0
        self._before: Any = None
        self._after = transport.sparsity.petsc(self._values)
        self._iterations: dict[int, Any] = {}
        self._solver: Any = None
        self._direct: Any = None
        self._right, self._left = self._after.createVecRight(), self._after.createVecLeft()

    def change(self, added: np.ndarray, before: Any) -> None:
        """Take what a wind adds to the matrix on the new concentration (CSR values), and the one on the old (SciPy)."""
        transport = self._transport
        self._before = before
        np.add(transport.calm, added, out=self._values)
        self._values[transport.fixed_entries] = 0.0
        self._values[transport.fixed_diagonal] = 1.0
        transport.sparsity.refresh(self._after, self._values)
        if self._direct is not None:
            self._direct.destroy()  # by all ranks together: dropped, its factors would stay on several
            self._direct = None
        self.strength = fill = strength(transport, self._values)
        if self.solved_directly:
            return
        if fill not in self._iterations:
            self._iterations[fill] = self._iteration(fill)
        self._solver = self._iterations[fill]
        self._solver.setOperators(self._after)
        self._solver.setUp()  # what depends on the pattern alone is done the first time
        if transport.sparsity.comm.size > 1:
            for block in self._solver.getPC().getBJacobiSubKSP():
                block.getPC().setType("ilu")
                block.getPC().setFactorLevels(fill)

    def _iteration(self, fill: int) -> Any:
        """Return a Krylov solver with an incomplete factorisation of so much fill."""
        from petsc4py import PETSc

        sparsity, options = self._transport.sparsity, self._transport.options
        solver: Any = PETSc.KSP().create(sparsity.comm)
        # BiCGStab in the form that does without a last application of the preconditioner; it watches the true residual.
        solver.setType("fbcgs")
        solver.getPC().setType("ilu" if sparsity.comm.size == 1 else "bjacobi")
        solver.getPC().setFactorLevels(fill)
        solver.setInitialGuessNonzero(True)
        solver.setTolerances(rtol=options.tolerance, atol=0.0, max_it=options.max_iterations)
        return solver

    @property
    def solved_directly(self) -> bool:
        """Whether the wind is too strong for an iteration."""
        return self.strength == len(BOUNDS)

    def step(self, concentration: np.ndarray, source: np.ndarray | None = None) -> np.ndarray:
        """Return the concentration (nodes,) one time step later.

        ``source`` (nodes,) is the rate f at the end of the step, in concentration per second. Raises SolverError where
        the tolerance is not reached and ContractError where an array has another shape.
        """
        transport = self._transport
        for array in (concentration,) if source is None else (concentration, source):
            if array.shape != (transport.nodes,):
                raise ContractError(f"transport: expected {transport.nodes} nodal values, got shape {array.shape}")
        supplied = concentration if source is None else concentration + transport.dt * source
        self._left.array[:] = self._before @ transport.sparsity.with_ghosts(supplied)
        self._left.array[transport.outer] = 0.0
        self._right.array[:] = concentration
        self._right.array[transport.outer] = 0.0
        if not self.solved_directly:
            self._solver.solve(self._left, self._right)
        if self.solved_directly or self._solver.getConvergedReason() <= 0:
            self._solve_directly()
        return self._right.array.copy()

    def _solve_directly(self) -> None:
        """Solve with a sparse LU, made once per wind."""
        from petsc4py import PETSc

        if self._direct is None:
            self._direct = PETSc.KSP().create(self._transport.sparsity.comm)
            self._direct.setOperators(self._after)
            self._direct.setType("preonly")
            self._direct.getPC().setType("lu")
            self._direct.getPC().setFactorSolverType("mumps")
        self._direct.solve(self._left, self._right)
        missed = self._left.duplicate()
        self._after.mult(self._right, missed)
        missed.aypx(-1.0, self._left)
        # What round-off leaves grows with the matrix: the backward error is what a direct solve can be held to.
        scale = self._left.norm() + self._after.norm(PETSc.NormType.NORM_INFINITY) * self._right.norm()
        residual, tolerance = missed.norm(), self._transport.options.tolerance
        if not residual <= tolerance * scale:
            raise SolverError(
                f"transport: a direct solve left a residual of {residual:.3g}, expected at most {tolerance:.3g} times "
                f"{scale:.3g}"
            )
