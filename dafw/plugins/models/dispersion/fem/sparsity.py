"""The matrices of one finite-element space as plain CSR arrays.

On a mesh that DOLFINx divided among several ranks, a rank has the rows that it owns. The columns count the rank's own
unknowns first, then the ghosts: the unknowns of other ranks that its rows touch. On one rank there are no ghosts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx import fem, la
from petsc4py import PETSc
from scipy.sparse import csr_matrix


class Sparsity:
    """The sparsity pattern that all matrices of a space share, so that they add up entry by entry.

    Attributes:
        comm: the MPI communicator of the mesh.
        size: number n of the unknowns that this rank owns.
        indptr: (n + 1,) start of every row, CSR.
        indices: (z,) column of every entry, CSR.
        rows: (z,) row of every entry.
    """

    def __init__(self, form: Any):
        """Take the sparsity pattern of a bilinear form."""
        self._matrix = fem.create_matrix(form)
        owned, self._columns = self._matrix.index_map(0), self._matrix.index_map(1)
        self.comm = owned.comm
        self.size: int = owned.size_local
        self.indptr = self._matrix.indptr[: self.size + 1].astype(np.int32)
        self.indices = self._matrix.indices[: self.indptr[-1]].astype(np.int32)
        self.rows = np.repeat(np.arange(self.size, dtype=np.int32), np.diff(self.indptr))
        self._with_ghosts = la.vector(self._columns)

    @property
    def shape(self) -> tuple[int, int]:
        """The number of owned rows, and of columns with the ghosts."""
        return self.size, self._columns.size_local + self._columns.num_ghosts

    def csr(self, values: np.ndarray) -> Any:
        """Return the SciPy matrix with the CSR ``values`` (z,); both share their memory."""
        return csr_matrix((values, self.indices, self.indptr), shape=self.shape)

    def assemble(self, form: Any) -> np.ndarray:
        """Return the CSR values (z,) of a bilinear form in the owned rows: a view that the next call overwrites."""
        self._matrix.data[:] = 0.0
        fem.assemble_matrix(self._matrix, form)
        self._matrix.scatter_reverse()
        values: np.ndarray = self._matrix.data[: self.indices.size]
        return values

    def with_ghosts(self, owned: np.ndarray) -> np.ndarray:
        """Return values for all columns from those of the owned unknowns (n,); a collective call.

        On one rank that is ``owned`` itself.
        """
        if self.comm.size == 1:
            return owned
        self._with_ghosts.array[: self.size] = owned
        self._with_ghosts.scatter_forward()
        return self._with_ghosts.array.astype(owned.dtype)

    def petsc(self, values: np.ndarray) -> Any:
        """Return a PETSc matrix with the CSR ``values`` (z,).

        Call ``refresh`` after a change of ``values``. On one rank the matrix shares its memory with them.
        """
        if self.comm.size == 1:
            return PETSc.Mat().createAIJWithArrays(
                (self.size, self.size), (self.indptr, self.indices, values), comm=self.comm
            )
        # On several ranks PETSc frees what was dropped only when all of them call this.
        PETSc.garbage_cleanup(self.comm)
        matrix: Any = PETSc.Mat().create(self.comm)
        matrix.setSizes(((self.size, None), (self.size, None)))
        matrix.setType("aij")
        first, _ = self._columns.local_range
        places = self._columns.local_to_global(np.arange(self.shape[1], dtype=np.int32))
        matrix.setPreallocationCOO(first + self.rows, places[self.indices].astype(PETSc.IntType))
        self.refresh(matrix, values)
        return matrix

    def refresh(self, matrix: Any, values: np.ndarray) -> None:
        """Set the values of a matrix that ``petsc`` made to the CSR ``values`` (z,) that it was made from."""
        if self.comm.size > 1:
            matrix.setValuesCOO(values)
        matrix.assemble()


def total(comm: Any, part: Any) -> Any:
    """Return the sum of a number or an array over all ranks; a collective call.

    The parts are added in the order of the ranks, so that every rank gets the same bits. On one rank it is ``part``.
    """
    return part if comm.size == 1 else sum(comm.allgather(part))
