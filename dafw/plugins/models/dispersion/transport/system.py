"""The linear system of a transport step in one wind, ``solver: iterative``: BiCGStab with a suitable preconditioner.

Where the wind is too strong for that, or an iteration does not converge, the system is solved directly, by MUMPS.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dafw.core.errors import SolverError
from dafw.plugins.models.dispersion.fem.sparsity import total
from dafw.plugins.models.dispersion.transport.matrices import TransportMatrices

# isort: split
from petsc4py import PETSc

BOUNDS = (2.5, 12.0)
"""Bounds on how strong a wind is.

A wind exceeds a bound if in more than 5 % of the rows of its matrix the off-diagonal absolute sum exceeds bound times
the diagonal.

Up to the first bound BiCGStab is preconditioned by ILU(0), which is made faster than ILU(1) and works as well there; a
whole run is 3 % faster by it (docs/fast-winds.md has this and the other figures of whole runs in these modules).
Up to the second bound it is preconditioned by ILU(1) and mostly takes ten iterations or fewer. Not far above the second
bound it fails, and a sparse LU is faster.
"""


def strength(matrices: TransportMatrices, after: np.ndarray) -> int:
    """Return how many of the ``BOUNDS`` a wind exceeds; it depends on the matrix alone and is the same on all ranks.

    Args:
        matrices: those of the transport.
        after: (z,) CSR values of the matrix on the new concentration.
    """
    absolute = np.abs(after)
    diagonal, row_sums = absolute[matrices.diagonal], np.add.reduceat(absolute, matrices.row_starts)
    counts = [np.count_nonzero(row_sums > (1.0 + bound) * diagonal) for bound in BOUNDS]
    *counts, nodes = total(matrices.sparsity.comm, np.array([*counts, matrices.nodes])).tolist()
    return sum(20 * rows > nodes for rows in counts)


class TransportSystem:
    """The matrix of a step in one wind, with its preconditioner; ``Transport.system`` makes it.

    Attributes:
        strength: how many of the ``BOUNDS`` the wind exceeds. It is also the fill level of the ILU; with all bounds
            exceeded the system is solved directly.
    """

    def __init__(self, matrices: TransportMatrices):
        self._matrices = matrices
        self._values = np.zeros(matrices.sparsity.indices.size)
        self.strength = 0
        self._before: Any = None
        self._after = matrices.sparsity.petsc(self._values)
        self._iterations: dict[int, Any] = {}
        self._solver: Any = None
        self._direct: Any = None
        self._right, self._left = self._after.createVecRight(), self._after.createVecLeft()

    def change(self, added: np.ndarray, before: Any) -> None:
        """Set the system to that of another wind.

        Args:
            added: (z,) CSR values that the wind adds to the matrix on the new concentration.
            before: the SciPy matrix on the old concentration.
        """
        matrices = self._matrices
        self._before = before
        matrices.after(added, self._values)
        matrices.sparsity.refresh(self._after, self._values)
        if self._direct is not None:
            # Destroyed by all ranks at once: if it were only dropped, its factors would stay in memory.
            self._direct.destroy()
            self._direct = None
        self.strength = fill = strength(matrices, self._values)
        if self.solved_directly:
            return
        if fill not in self._iterations:
            self._iterations[fill] = self._iteration(fill)
        self._solver = self._iterations[fill]
        self._solver.setOperators(self._after)
        self._solver.setUp()  # the symbolic factorisation is done only the first time
        if matrices.sparsity.comm.size > 1:
            for block in self._solver.getPC().getBJacobiSubKSP():
                block.getPC().setType("ilu")
                block.getPC().setFactorLevels(fill)

    def _iteration(self, fill: int) -> Any:
        """Return a Krylov solver with an incomplete factorisation of the given fill level."""
        sparsity, options = self._matrices.sparsity, self._matrices.options
        solver: Any = PETSc.KSP().create(sparsity.comm)
        # Flexible BiCGStab saves the last application of the preconditioner and monitors the true residual. With plain
        # BiCGStab a whole run takes 9 % longer.
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

        Args:
            concentration: (nodes,) at the start of the step.
            source: (nodes,) rate f at the end of the step, in concentration per second; None is no source.

        Raises SolverError if the tolerance is not reached, and ContractError if an array has another shape.
        """
        matrices = self._matrices
        supplied = matrices.supplied(concentration, source)
        self._left.array[:] = self._before @ matrices.sparsity.with_ghosts(supplied)
        self._left.array[matrices.fixed] = 0.0
        self._right.array[:] = concentration
        self._right.array[matrices.fixed] = 0.0
        if not self.solved_directly:
            self._solver.solve(self._left, self._right)
        if self.solved_directly or self._solver.getConvergedReason() <= 0:
            self._solve_directly()
        return self._right.array.copy()

    def _solve_directly(self) -> None:
        """Solve with a sparse LU, which is made once for a wind."""
        if self._direct is None:
            self._direct = PETSc.KSP().create(self._matrices.sparsity.comm)
            self._direct.setOperators(self._after)
            self._direct.setType("preonly")
            self._direct.getPC().setType("lu")
            self._direct.getPC().setFactorSolverType("mumps")
        self._direct.solve(self._left, self._right)
        residual_vector = self._left.duplicate()
        self._after.mult(self._right, residual_vector)
        residual_vector.aypx(-1.0, self._left)
        # Round-off grows with the norm of the matrix, so a direct solve is judged by its backward error.
        scale = self._left.norm() + self._after.norm(PETSc.NormType.NORM_INFINITY) * self._right.norm()
        residual, tolerance = residual_vector.norm(), self._matrices.options.tolerance
        if not residual <= tolerance * scale:
            raise SolverError(
                f"transport: a direct solve left a residual of {residual:.3g}, expected at most {tolerance:.3g} times "
                f"{scale:.3g}"
            )
