"""The edges between the nodes: what the gas is exchanged along, in flux-corrected transport."""

from __future__ import annotations

import numpy as np

from dafw.plugins.models.dispersion.fem.sparsity import Sparsity


class Edges:
    """The pairs of nodes that share a triangle, each once; e is their number.

    All are of type uint32: numba then does not look for negative indices, and the limiter is 12 % quicker.

    Attributes:
        starts: (n + 1,) node i is the first one of the edges from ``starts[i]`` to before ``starts[i + 1]``.
        second: (e,) the second node of every edge.
        there: (e,) index of the CSR entry in the row of the first node and the column of the second.
        back: (e,) index of the CSR entry in the row of the second node and the column of the first.
    """

    def __init__(self, sparsity: Sparsity):
        """Take the edges from a sparsity pattern, which is symmetric, of a mesh that is not divided."""
        rows, columns, size = sparsity.rows, sparsity.indices, sparsity.size
        # Sorted by row and column, and by column and row: entry k of one is the transpose of entry k of the other.
        by_rows, by_columns = np.lexsort((columns, rows)), np.lexsort((rows, columns))
        transposed = np.empty(rows.size, dtype=np.intp)
        transposed[by_rows] = by_columns
        there = np.flatnonzero(rows < columns)
        self.starts: np.ndarray = np.searchsorted(rows[there], np.arange(size + 1)).astype(np.uint32)
        self.second: np.ndarray = columns[there].astype(np.uint32)
        self.there: np.ndarray = there.astype(np.uint32)
        self.back: np.ndarray = transposed[there].astype(np.uint32)
