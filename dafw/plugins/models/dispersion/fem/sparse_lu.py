"""The sparse LU of a matrix that needs no pivoting, such as an M-matrix."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dafw.core.errors import SolverError
from dafw.plugins.models.dispersion.fem.sparsity import Sparsity

# isort: split
from scipy.sparse.linalg import splu


def factorised(sparsity: Sparsity, values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that solves with the matrix: from right-hand sides (n,) or (n, k) to the solutions.

    The matrix is factorised by SuperLU with an ordering for symmetric patterns and without pivoting. The values are
    not needed afterwards. Raises SolverError if the matrix is singular.

    Args:
        sparsity: the pattern, which is symmetric, of a mesh that is not divided.
        values: (z,) CSR values.
    """
    try:
        factors = splu(
            sparsity.csr(values).tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
    except RuntimeError as error:
        raise SolverError(f"sparse LU: {error}") from error
    solve: Callable[[np.ndarray], np.ndarray] = factors.solve
    return solve
