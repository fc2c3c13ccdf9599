"""The twin experiment: the readings are those that the observer would take of a truth, with noise.

y = H(truth) + e,    e ~ N(0, R)    with the covariance R that the readings' noise has (not what the filter is told)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dafw.core.errors import ContractError
from dafw.core.interfaces import Readings
from dafw.core.interfaces.readings import Request
from dafw.core.observation import Observation, colour


@dataclass
class Twin(Readings):
    """Reads the study's truth along the route; no reading is late."""

    needs_truth = True

    def take(self, request: Request, rng: np.random.Generator) -> Sequence[Observation]:
        """Return the one observation at the end of the cycle."""
        if request.truth is None:
            raise ContractError(f"{self.label} reads a truth, and the study has none")
        operator = request.operator
        noise = colour(operator.noise, rng.standard_normal(operator.size))
        return [Observation(operator.apply(request.truth.members)[0] + noise, operator, request.end)]
