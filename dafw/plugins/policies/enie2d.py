"""EnIE-2D, ensemble interval estimation: fly towards the sector that is most uncertain, or most polluted.

The plane around the vehicle is divided into Q sectors. Sector q holds the M_q nodes whose direction from the vehicle is
in [(q - 1) 2 pi / Q, q 2 pi / Q). Its score, with anomalies A_q (N, M_q) and mean mu (M_q,) of the concentration, is ::

    1 / M_q ( sqrt( tr(A_q A_q^T) / (N - 1) ) + theta_t sum_j mu_j )

The vehicle flies a full step along the middle of the best sector, q 2 pi / Q - pi / Q. If a building or the edge of the
domain is in the way, 2 pi / Q is subtracted until the way is free. If no direction is free, the vehicle hovers and the
log says so.

Gioia et al. (2024), eq. (EnIE), doi:10.1109/SDF63218.2024.10773899. A sector without nodes is never chosen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dafw.core.ensemble import Diagnostic, Ensemble, Route, Vehicle, handed_over
from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Policy
from dafw.core.options import option
from dafw.core.space import Array, StateSpace

TWO_PI = 2.0 * np.pi


def sector_scores(
    variance: Array, mean: Array, coordinates: Array, position: Array, n_sectors: int, theta: float
) -> Array:
    """Return the score (Q,) of each sector around ``position`` (2,); minus infinity for a sector without nodes.

    ``variance`` (M,) and ``mean`` (M,) are those of the concentration at the nodes, ``coordinates`` (M, 2) in metres.
    tr(A_q A_q^T) / (N - 1) is the sum of the variances.
    """
    angle = np.arctan2(coordinates[:, 1] - position[1], coordinates[:, 0] - position[0])
    angle += TWO_PI * (angle < 0.0)
    # For unsorted angles a binary search mispredicts branches; comparing all angles with each edge is faster. Bytes
    # count up to 127 edges. Wider numbers take four times as long: 45 instead of 11 microseconds for 2,715 nodes, of
    # 1 ms that a cycle takes outside of model and filter.
    passed: Any = np.zeros(len(angle), dtype=np.int8 if n_sectors <= 128 else np.intp)
    for edge in np.arange(1, n_sectors) * TWO_PI / n_sectors:
        passed += (angle >= edge).view(np.int8)
    sector = passed.astype(np.intp)
    nodes = np.bincount(sector, minlength=n_sectors)
    total_variance = np.bincount(sector, variance, minlength=n_sectors)
    total_mean = np.bincount(sector, mean, minlength=n_sectors)
    scores = np.full(n_sectors, -np.inf)
    return np.divide(np.sqrt(total_variance) + theta * total_mean, nodes, out=scores, where=nodes > 0)


@dataclass
class EnIE2D(Policy):
    """Balances the spread of the belief against its mean, sector by sector."""

    sectors: int = option(8, "number Q of sectors around the vehicle", minimum=1)
    theta: Any = option(0.2, "weight of the mean: a number, or [[time in s, weight], ...] with linear interpolation")
    variable: str = option("concentration", "state variable whose spread and mean are used; it needs coordinates")

    def __post_init__(self) -> None:
        schedule = [[0.0, self.theta]] if isinstance(self.theta, int | float) else self.theta
        try:
            times, weights = np.array(schedule, dtype=np.float64).T
        except (TypeError, ValueError):
            times, weights = np.array([]), np.array([])
        if not (times.size and np.isfinite(weights).all() and np.all(np.diff(times) > 0.0)):
            raise ConfigurationError(
                f"policy 'enie2d': theta must be a number or [[time, weight], ...] with rising times, got {self.theta}"
            )
        self._times, self._weights = times, weights

    def weight(self, t: float) -> float:
        """Return theta_t; constant before the first and after the last time of a schedule."""
        return float(self._weights[0] if len(self._times) == 1 else np.interp(t, self._times, self._weights))

    def suit(self, space: StateSpace) -> None:
        """Raise ConfigurationError if the variable does not exist or has no coordinates in the plane."""
        self.require_places(space, self.variable)

    def decide(self, belief: Ensemble, vehicle: Vehicle, rng: np.random.Generator) -> Route:
        """Return one straight leg for each vehicle, decided independently of the others."""
        if not len(vehicle.positions):
            return Route(())
        coordinates = self.require_places(belief.space, self.variable)
        part = belief.space.slice(self.variable)
        mean = belief.mean[part]
        variance = belief.variance[part] if len(belief) > 1 else np.zeros_like(mean)
        theta = self.weight(belief.time)
        scores = np.empty((len(vehicle.positions), self.sectors))
        paths, notes = [], []
        for number, position in enumerate(vehicle.positions):
            scores[number] = sector_scores(variance, mean, coordinates, position, self.sectors, theta)
            path = self._leg(position, int(np.argmax(scores[number])), vehicle)
            if len(path) == 1:
                notes.append(f"vehicle {number} hovers at {position.round(1).tolist()}: every way is blocked")
            paths.append(path)
        recorded = Diagnostic(scores, ("vehicle", "sector"), long_name="score of each sector at the decision")
        return Route(tuple(paths), diagnostics={"sector_score": recorded}, notes=tuple(notes), dt=vehicle.dt)

    def _leg(self, position: Array, best: int, vehicle: Vehicle) -> Array:
        """Return the first free leg (2, 2), clockwise from the best sector, or the position alone (1, 2)."""
        for turn in range(self.sectors):
            angle = (best + 0.5 - turn) * TWO_PI / self.sectors
            end = position + vehicle.reach * np.array([np.cos(angle), np.sin(angle)])
            if vehicle.airspace is None or vehicle.airspace.is_free(position, end):
                return handed_over(np.array([position, end]))
        return position[np.newaxis]
