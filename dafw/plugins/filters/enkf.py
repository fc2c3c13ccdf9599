"""The stochastic ensemble Kalman filter with perturbed observations.

With the forecast anomalies A (N, n), and the predicted anomalies Y (N, m), the innovations dy_i = y - h_i (N, m) and
standard normal perturbations Z (N, m) less their mean, all three in units of the readings' errors (R = I)::

    E = members + (dy - Z) Y^T (Y Y^T + (N - 1) I)^-1 A

This is the gain A^T Y (Y^T Y + (N - 1) R)^-1 of the space of readings, written in the (N, N) space of the ensemble.

Burgers, van Leeuwen and Evensen (1998), doi:10.1175/1520-0493(1998)126<1719:ASITEK>2.0.CO;2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dafw.core.covariances import whiten_both
from dafw.core.ensemble import Analysis, Ensemble
from dafw.core.interfaces import Filter
from dafw.core.observation import Observation
from dafw.core.options import option
from dafw.core.space import Array


@dataclass
class EnKF(Filter):
    """Every member is updated with the readings plus its own random error; no localization."""

    inflation: float = option(1.0, "factor on the forecast anomalies before the analysis", minimum=1.0)

    def analyse(
        self, forecast: Ensemble, predicted: Array, observation: Observation, rng: np.random.Generator
    ) -> Analysis:
        """Return the inflated members, each moved by the gain and kept in the range of each variable."""
        anomalies = self.inflation * forecast.anomalies
        predicted_mean = np.add.reduce(predicted, axis=0) / len(predicted)
        predicted_anomalies = self.inflation * (predicted - predicted_mean)
        innovations = observation.values - predicted_mean - predicted_anomalies
        Y, dy = whiten_both(observation.covariance, predicted_anomalies, innovations)  # noqa: N806
        Z = rng.standard_normal(Y.shape)  # noqa: N806
        Z -= Z.mean(axis=0)  # noqa: N806
        gram = Y.dot(Y.T)
        gram.flat[:: len(Y) + 1] += len(Y) - 1  # its diagonal
        gain = np.linalg.solve(gram, anomalies)
        return Analysis(forecast.space.retract(forecast.mean, anomalies + (dy - Z).dot(Y.T).dot(gain)))
