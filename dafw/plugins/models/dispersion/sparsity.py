"""The matrices of one space as plain arrays: of a mesh that DOLFINx partitioned, the rows that this rank owns.

On a mesh of one rank those are all rows. Columns count the rank's own unknowns first, then the unknowns of other ranks
that its rows touch (ghosts).
"""

from __future__ import annotations

from typing import Any

from dafw.plugins.models.dispersion import libraries  # noqa: F401  (before dolfinx)

# isort: split
import numpy as np
from dolfinx import fem, la
from petsc4py import PETSc
from scipy.sparse import csr_matrix


class Sparsity:
    """What all matrices of a space share; they add up entry by entry.

    Attributes:
        comm: the ranks of the mesh.
        size: the unknowns n that this rank owns.
        indptr, indices, rows: CSR of the owned rows, and the row of every entry.
    """

    def __init__(self, form: Any):
        """Take the sparsity of a bilinear form."""
        self._matrix = fem.create_matrix(form)
        owned, self._columns = self._matrix.index_map(0), self._matrix.index_map(1)
        self.comm = owned.comm
        self.size: int = owned.size_local
        self.indptr = self._matrix.indptr[: self.size + 1].astype(np.int32)
        self.indices = self._matrix.indices[: self.indptr[-1]].astype(np.int32)
        self.rows = np.repeat(np.arange(self.size, dtype=np.int32), np.diff(self.indptr))
        self._beside = la.vector(self._columns)

    @property
    def shape(self) -> tuple[int, int]:
        """Owned rows, and columns with ghosts."""
        return self.size, self._columns.size_local + self._columns.num_ghosts

    def csr(self, values: np.ndarray) -> Any:
        """Return the SciPy matrix of CSR ``values``, which it shares."""
        return csr_matrix((values, self.indices, self.indptr), shape=self.shape)

    def assemble(self, form: Any) -> np.ndarray:
        """Return the CSR values of a form in the owned rows: a view, until the next call."""
        self._matrix.data[:] = 0.0
        fem.assemble_matrix(self._matrix, form)
        self._matrix.scatter_reverse()
        values: np.ndarray = self._matrix.data[: self.indices.size]
        return values

    def with_ghosts(self, owned: np.ndarray) -> np.ndarray:
        """Return numbers (n,) in all columns, what other ranks own fetched from them; as they are on one rank."""
        if self.comm.size == 1:
            return owned
        self._beside.array[: self.size] = owned
        self._beside.scatter_forward()
        return self._beside.array.astype(owned.dtype)

    def petsc(self, values: np.ndarray) -> Any:
        """Return a PETSc matrix with CSR ``values``, which it shares on one rank; ``refresh`` it after a change."""
        if self.comm.size == 1:
            return PETSc.Mat().createAIJWithArrays(
                (self.size, self.size), (self.indptr, self.indices, values), comm=self.comm
            )
        PETSc.garbage_cleanup(self.comm)  # what was dropped on several ranks waits for all of them to say so
        matrix: Any = PETSc.Mat().create(self.comm)
        matrix.setSizes(((self.size, None), (self.size, None)))
        matrix.setType("aij")
        first, _ = self._columns.local_range
        places = self._columns.local_to_global(np.arange(self.shape[1], dtype=np.int32))
        matrix.setPreallocationCOO(first + self.rows, places[self.indices].astype(PETSc.IntType))
        self.refresh(matrix, values)
        return matrix

    def refresh(self, matrix: Any, values: np.ndarray) -> None:
        """Bring the values of a matrix of ``petsc`` up to date with the array that it was made from."""
        if self.comm.size > 1:
            matrix.setValuesCOO(values)
        matrix.assemble()


def total(comm: Any, part: Any) -> Any:
    """Return the sum of the ranks' parts, numbers or arrays: in the order of the ranks, so that all have the same bits.

    On one rank that is the part as it is.
    """
    return part if comm.size == 1 else sum(comm.allgather(part))
