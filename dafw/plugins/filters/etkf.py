"""The ensemble transform Kalman filter with a symmetric square root, Algorithm 1 of Gioia et al. (2024).

With the forecast anomalies A (N, n), the predicted anomalies Y (N, m), the innovation dy (m,) of the mean and the
error covariance R (m, m)::

    Y R^-1 Y^T + (N - 1) I = V diag(d) V^T                     (N, N)
    T      = sqrt(N - 1) V diag(d^-1/2) V^T                    (N, N)
    Lambda = dy R^-1 Y^T V diag(d^-1) V^T                      (N,)
    E      = mean + (Lambda + T) A                             (N, n)

Gioia et al., doi:10.1109/SDF63218.2024.10773899; Hunt et al. (2007), doi:10.1016/j.physd.2006.11.008;
Bishop et al. (2001), doi:10.1175/1520-0493(2001)129<0420:ASWTET>2.0.CO;2.

The paper's Algorithm 1 divides by sigma_ob where R^-1 asks for its square. Here R is what the observer says the
covariance is; the paper's experiment says so by an assumed variance (conf/observer/paper_drone.yaml).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dafw.core.ensemble import Analysis, Ensemble
from dafw.core.interfaces import Filter
from dafw.core.observation import Observation, whiten
from dafw.core.options import option
from dafw.core.space import Array


def transform(predicted_anomalies: Array, innovation: Array, covariance: Array) -> tuple[Array, Array]:
    """Return the weights Lambda (N,) of the mean and the transform T (N, N) of the anomalies.

    ``predicted_anomalies`` Y (N, m), ``innovation`` dy (m,), ``covariance`` R (m,) or (m, m).
    """
    n_members = len(predicted_anomalies)
    Y = whiten(covariance, predicted_anomalies)  # noqa: N806
    dy = whiten(covariance, innovation)
    d, V = np.linalg.eigh(Y @ Y.T + (n_members - 1) * np.eye(n_members))  # noqa: N806
    T = np.sqrt(n_members - 1) * (V / np.sqrt(d)) @ V.T  # noqa: N806
    Lambda = (dy @ Y.T) @ (V / d) @ V.T  # noqa: N806
    return Lambda, T


@dataclass
class ETKF(Filter):
    """Deterministic square-root filter in the space of the ensemble; no localization."""

    inflation: float = option(1.0, "factor on the forecast anomalies before the analysis", minimum=1.0)

    def analyse(
        self, forecast: Ensemble, predicted: Array, observation: Observation, rng: np.random.Generator
    ) -> Analysis:
        """Return mean + (Lambda + T) anomalies, brought back into the state's set."""
        predicted_mean = predicted.mean(axis=0)
        weights, matrix = transform(
            self.inflation * (predicted - predicted_mean), observation.values - predicted_mean, observation.covariance
        )
        increments = (weights + matrix) @ (self.inflation * forecast.anomalies)
        return Analysis(forecast.space.retract(forecast.mean, increments))
