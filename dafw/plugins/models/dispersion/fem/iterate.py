"""The end of an iteration for a wind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Iterate:
    """The vector that an iteration ended with.

    Attributes:
        unknowns: (n,) the vector.
        residual: Euclidean norm of its residual.
        factorisations: how many were made.
        converged: whether the residual is at most the target.
    """

    unknowns: np.ndarray
    residual: float
    factorisations: int
    converged: bool
