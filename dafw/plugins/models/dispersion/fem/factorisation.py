"""The sparse LU factorisation of matrices of one sparsity pattern, by MUMPS."""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc

from dafw.plugins.models.dispersion.fem.sparsity import Sparsity


class Factorisation:
    """One factorised matrix at a time. The ordering is found once and serves all of them.

    On a mesh that is divided among several ranks all methods are collective calls.
    """

    def __init__(self, sparsity: Sparsity, *, single: bool = False):
        """Prepare the solver.

        Args:
            sparsity: the pattern of the matrices.
            single: factorise in single precision, which takes half the memory and leaves about seven digits. That is
                enough for a preconditioner.
        """
        self._sparsity, self._single = sparsity, single
        # All entries of the pattern are kept, also those that are zero. Otherwise the ordering would depend on the
        # matrix that happens to be factorised first.
        self._values = np.zeros(sparsity.indices.size)
        self._matrix = sparsity.petsc(self._values)
        self._solver = PETSc.KSP().create(sparsity.comm)
        self._solver.setOperators(self._matrix)
        self._solver.setType("preonly")
        preconditioner = self._solver.getPC()
        preconditioner.setType("lu")
        preconditioner.setFactorSolverType("mumps")
        preconditioner.setFactorSetUpSolverType()
        mumps = preconditioner.getFactorMatrix()
        mumps.setMumpsIcntl(7, 5)  # ordering: METIS
        mumps.setMumpsIcntl(6, 0)  # no permutation by value, so that the analysis depends on the pattern alone
        mumps.setMumpsIcntl(8, 7)  # rows and columns are scaled anew in every factorisation
        mumps.setMumpsIcntl(14, 100)  # per cent of extra workspace for delayed pivots
        self._right, self._left = self._matrix.createVecRight(), self._matrix.createVecLeft()

    def factorise(self, values: np.ndarray, fixed: np.ndarray) -> None:
        """Factorise a matrix; rows and columns of fixed unknowns are replaced by those of the identity.

        Args:
            values: (z,) CSR values of the matrix; overwritten.
            fixed: (n,) bool, true for the unknowns whose values are prescribed.
        """
        sparsity = self._sparsity
        fixed_entry = fixed[sparsity.rows] | sparsity.with_ghosts(fixed)[sparsity.indices]
        values[fixed_entry] = sparsity.rows[fixed_entry] == sparsity.indices[fixed_entry]
        self._values[:] = values
        sparsity.refresh(self._matrix, self._values)
        self._solver.setOperators(self._matrix)
        if not self._single:
            self._solver.setUp()
            return
        options: Any = PETSc.Options()
        options["pc_precision"] = "single"  # PETSc has no other way to set this; it is read by setUp
        try:
            self._solver.setUp()
        finally:
            options.delValue("pc_precision")

    @property
    def megabytes(self) -> int:
        """The memory of the last factorisation in MB (10^6 bytes), as MUMPS reports it."""
        return int(self._solver.getPC().getFactorMatrix().getMumpsInfog(22))

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return the solution (n,) for a right-hand side (n,); not-a-number everywhere if PETSc reports a failure."""
        self._left.array[:] = right
        self._solver.solve(self._left, self._right)
        if not self._solver.is_converged:
            return np.full(right.size, np.nan)
        return self._right.array.copy()
