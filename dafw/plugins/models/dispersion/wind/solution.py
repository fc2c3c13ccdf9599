"""A wind that was solved, and the error where none was."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dafw.core.errors import SolverError


class WindError(SolverError):
    """No wind within the tolerance was found; there is nothing to use."""


@dataclass(frozen=True)
class WindSolution:
    """A converged wind.

    Attributes:
        unit: (n,) unknowns of the unit wind.
        intensity: in m/s.
        direction: towards which the air moves, in radians.
        reynolds: unit Reynolds number intensity / viscosity, in 1/m.
        iterations: factorisations that were made.
        residual: norm of the residual, relative like the solver's tolerance.
    """

    unit: np.ndarray
    intensity: float
    direction: float
    reynolds: float
    iterations: int
    residual: float
