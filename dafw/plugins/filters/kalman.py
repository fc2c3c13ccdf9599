"""The exact Kalman filter, on an ensemble that is large enough to represent its moments.

An ensemble of N > n members can have any mean and covariance of n numbers exactly. So the model and the loop need not
change, and a linear model propagates the moments exactly. This filter

1. takes mean x and covariance P from the forecast (divisor N - 1);
2. updates them by ``filterpy.kalman.KalmanFilter.update``;
3. makes members with exactly the updated moments, without drawing: E = x + sqrt(N - 1) Q S with S the symmetric root
   of P and Q (N, n) the orthonormal columns of zero mean that change the members least (orthogonal Procrustes).

Kalman (1960), doi:10.1115/1.3662552; Schönemann (1966), doi:10.1007/BF02289451.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dafw.core.ensemble import Analysis, Ensemble
from dafw.core.errors import ComputationError, ConfigurationError
from dafw.core.interfaces import Filter
from dafw.core.observation import Observation, ObservationOperator
from dafw.core.space import Array, Kind, StateSpace
from dafw.plugins.filters.rotation import zero_mean_basis

LINEAR = 1e-9


def operator_matrix(operator: ObservationOperator, size: int) -> tuple[Array, Array]:
    """Return H (m, n) and h_0 (m,) of an affine operator x -> H x + h_0, by applying it to the unit vectors."""
    offset = operator.apply(np.zeros((1, size)))[0]
    return (operator.apply(np.eye(size)) - offset).T, offset


def members_with(mean: Array, covariance: Array, near: Array) -> Array:
    """Return members (N, n) of exactly this mean (n,) and covariance (n, n), nearest to the anomalies ``near`` (N, n).

    Needs N > n.
    """
    variances, axes = np.linalg.eigh(covariance)
    root = (axes * np.sqrt(np.maximum(variances, 0.0))) @ axes.T
    basis = zero_mean_basis(len(near))
    left, _, right = np.linalg.svd(basis.T @ near @ root, full_matrices=False)
    return np.asarray(mean + np.sqrt(len(near) - 1) * (basis @ (left @ right) @ root))


@dataclass
class Kalman(Filter):
    """Exact for linear models without drawn model error, linear operators and fields; no options, no randomness.

    Raises ConfigurationError if N <= n or the state has angles or bounds, ComputationError if the operator is not
    linear.
    """

    accuracy = "exact"

    def suit(self, space: StateSpace, n_members: int) -> None:
        """Raise ConfigurationError if N <= n or the state has angles or bounds."""
        if n_members <= space.size:
            raise ConfigurationError(
                f"{self.label} needs more members than the state has numbers ({space.size}), the study has {n_members}"
            )
        if other := [v.name for v in space.variables if v.kind is not Kind.FIELD]:
            raise ConfigurationError(f"{self.label} takes plain fields only, '{other[0]}' has angles or bounds")

    def analyse(
        self, forecast: Ensemble, predicted: Array, observation: Observation, rng: np.random.Generator
    ) -> Analysis:
        """Return members with the moments of the Kalman update."""
        from filterpy.kalman import KalmanFilter

        n_members, size = forecast.members.shape
        self.suit(forecast.space, n_members)
        H, offset = operator_matrix(observation.operator, size)  # noqa: N806
        if not np.allclose(predicted, forecast.members @ H.T + offset, rtol=LINEAR, atol=LINEAR * np.abs(H).max()):
            raise ComputationError(f"{self.label} needs a linear observation operator, this one is not")

        engine = KalmanFilter(dim_x=size, dim_z=len(H))
        engine.x = forecast.mean[:, np.newaxis]
        engine.P = forecast.anomalies.T @ forecast.anomalies / (n_members - 1)
        covariance = observation.covariance
        R = np.diag(covariance) if covariance.ndim == 1 else covariance  # noqa: N806
        engine.update((observation.values - offset)[:, np.newaxis], R=R, H=H)
        return Analysis(members_with(engine.x[:, 0], 0.5 * (engine.P + engine.P.T), forecast.anomalies))
