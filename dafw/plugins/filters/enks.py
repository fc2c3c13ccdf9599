"""The ensemble Kalman smoother: readings also change the beliefs at earlier times.

The present readings y change the forecast E and, by the same weights, the beliefs E_s at all earlier times s in the
window. With predicted anomalies Y (N, m), innovation dy (m,), and the ETKF's weights and transform ::

    Lambda = dy R^-1 Y^T V diag(d^-1) V^T                      (N,)
    T      = sqrt(N - 1) V diag(d^-1/2) V^T                    (N, N)
    E_s   <- mean_s + (Lambda + T) A_s                         for every s

where A_s are the anomalies of E_s. If the window begins at the start, this is the fixed-interval smoother; for linear
models and Gaussian errors it has the moments of the Rauch-Tung-Striebel smoother, without a backward pass. For a late
reading, Y and dy come from the belief at the reading's own time; it changes the beliefs at all times in the same way.

Evensen and van Leeuwen (2000), doi:10.1175/1520-0493(2000)128<1852:AEKSFN>2.0.CO;2. The transform is that of
dafw.plugins.filters.etkf. Inflation is applied before the present update, to the present forecast alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dafw.core.ensemble import Analysis, Ensemble
from dafw.core.interfaces import Filter
from dafw.core.observation import Observation
from dafw.core.options import option
from dafw.core.space import Array
from dafw.core.window import Window
from dafw.plugins.filters.etkf import transform


def updated(ensemble: Ensemble, weights: Array, matrix: Array) -> Array:
    """Return the members mean + (Lambda + T) A (N, n), kept in the range of each variable."""
    return ensemble.space.retract(ensemble.mean, (weights + matrix) @ ensemble.anomalies)


@dataclass
class EnKS(Filter):
    """A smoother over a window: of a fixed number of cycles, or of all since the start."""

    accuracy = "exact"

    window: int | None = option(
        None, "cycles that a reading changes, its own included; null: all since the start", minimum=1
    )
    inflation: float = option(1.0, "factor on the forecast anomalies before the analysis", minimum=1.0)

    def analyse_window(self, window: Window, rng: np.random.Generator) -> Analysis:
        """Return the analysis of the present, with the beliefs of the window revised."""
        revised = {cycle.number: window.belief_after(cycle.number - 1) for cycle in window.cycles[1:]}
        revised[window.cycles[0].number] = window.first
        forecast = window.forecast
        anomalies = self.inflation * forecast.ensemble.anomalies
        inflated = forecast.ensemble.space.retract(forecast.ensemble.mean, anomalies)
        beliefs = {**revised, window.cycles[-1].number + 1: forecast.with_members(inflated)}
        late = [(number + 1, observation) for number, observation in window.late]
        for cycles_done, observation in [*late, (window.cycles[-1].number + 1, window.observation)]:
            weights, matrix = self._transform(observation, beliefs[cycles_done].ensemble)
            beliefs = {
                done: belief.with_members(updated(belief.ensemble, weights, matrix)) for done, belief in beliefs.items()
            }
        present = beliefs.pop(window.cycles[-1].number + 1)
        return Analysis(present.ensemble.members, window.memory, revised=beliefs)

    def _transform(self, observation: Observation, belief: Ensemble) -> tuple[Array, Array]:
        """Return an observation's weights (N,) and transform (N, N); without readings they change nothing."""
        predicted = observation.operator.apply(belief.members)
        mean = predicted.mean(axis=0)
        return transform(predicted - mean, observation.values - mean, observation.covariance)
