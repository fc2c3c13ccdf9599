"""Small problems on which plugins are checked: spaces, beliefs, readings, and the Kalman filter's exact answers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from dafw.core.domain import Domain
from dafw.core.ensemble import Ensemble, Route, Vehicle
from dafw.core.observation import Observation, ObservationOperator
from dafw.core.space import ANGLE, NONNEGATIVE, POSITIVE, Array, StateSpace, Variable

NORTH, EAST = 200.0, 300.0
"""Sides in metres of the rectangle that the kit's own space and airspace fill."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Linear(ObservationOperator):
    """A linear operator by its ``matrix`` (m, n)."""

    matrix: Array

    def apply(self, members: Array) -> Array:
        """Return the readings (N, m)."""
        return np.asarray((members[:, np.newaxis] * self.matrix).sum(axis=2))  # rounds alike in batches of any size


@dataclass(frozen=True, eq=False)
class Problem:
    """A forecast, an observation operator, and the readings ``values`` (m,)."""

    forecast: Ensemble
    operator: Linear
    values: Array

    @property
    def observation(self) -> Observation:
        """The readings as a filter is given them."""
        return Observation(self.values, self.operator, self.forecast.time)

    @property
    def predicted(self) -> Array:
        """The readings (N, m) that the members predict; a new array each time."""
        return self.operator.apply(self.forecast.members)

    def with_members(self, members: Array) -> Problem:
        """Return the problem with another forecast (N, n)."""
        return replace(self, forecast=Ensemble(members, self.forecast.space, self.forecast.time))

    def in_order(self, order: Array) -> Problem:
        """Return the problem with its readings in another order (m,)."""
        old = self.operator
        R = old.covariance[order] if old.covariance.ndim == 1 else old.covariance[np.ix_(order, order)]  # noqa: N806
        places = None if old.coordinates is None else old.coordinates[order]
        operator = Linear(matrix=old.matrix[order], covariance=R, coordinates=places)
        return replace(self, operator=operator, values=self.values[order])

    def with_errors(self, factor: float) -> Problem:
        """Return the problem with R multiplied by ``factor``."""
        return replace(self, operator=replace(self.operator, covariance=factor * self.operator.covariance))

    def with_places(self, coordinates: Array) -> Problem:
        """Return the problem with its readings at other places (m, 2)."""
        return replace(self, operator=replace(self.operator, coordinates=coordinates))


def linear_problem(n_members: int, n: int = 5, m: int = 3, *, full: bool = False, seed: int = 0) -> Problem:
    """Return a linear-Gaussian problem: N members of n numbers on a line, m readings of them, R diagonal or ``full``.

    The members are drawn from ``prior(n)``.
    """
    rng = np.random.default_rng([seed, n, m])
    mean, covariance = prior(n)
    places = np.stack([np.linspace(0.0, EAST, n), np.zeros(n)], axis=1)
    space = StateSpace([Variable("quantity", n, units="1", coordinates=places)])
    members = mean + rng.standard_normal((n_members, n)) @ np.linalg.cholesky(covariance).T
    read = np.arange(m) * 2 % n
    matrix = 0.1 * rng.standard_normal((m, n))
    matrix[np.arange(m), read] += 1.0
    root = 0.3 * rng.standard_normal((m, m))
    variances = 0.5 + rng.random(m)
    R = root @ root.T + np.diag(variances) if full else variances  # noqa: N806
    operator = Linear(matrix=matrix, covariance=R, coordinates=places[read])
    values = matrix @ mean + 1.5 * rng.standard_normal(m)
    return Problem(Ensemble(members, space, 1.0), operator, values)


def prior(n: int) -> tuple[Array, Array]:
    """Return the mean (n,) and covariance (n, n) from which ``linear_problem`` draws its members."""
    distance = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    return np.linspace(-1.0, 2.0, n), 2.0 * np.exp(-distance / 2.0)


def kalman(mean: Array, covariance: Array, values: Array, operator: Linear) -> Array:
    """Return the Kalman filter's analysis mean (n,) and covariance (n, n) in one row (n + n * n,).

    Kalman (1960), doi:10.1115/1.3662552.
    """
    H, R = operator.matrix, operator.covariance  # noqa: N806
    R = np.diag(R) if R.ndim == 1 else R  # noqa: N806
    K = np.linalg.solve(H @ covariance @ H.T + R, H @ covariance).T  # noqa: N806
    return np.concatenate([mean + K @ (values - H @ mean), (covariance - K @ H @ covariance).ravel()])


@cache
def gas_space() -> StateSpace:
    """Return the kit's own space: a concentration at 12 nodes of a rectangle, a wind speed and a wind direction."""
    x, y = np.meshgrid(np.linspace(0.0, EAST, 4), np.linspace(0.0, NORTH, 3))
    nodes = np.stack([x.ravel(), y.ravel()], axis=1)
    return StateSpace(
        [
            Variable("concentration", len(nodes), NONNEGATIVE, "1", nodes),
            Variable("wind_speed", 1, NONNEGATIVE, "m s-1"),
            Variable("wind_direction", 1, ANGLE, "rad"),
        ]
    )


def belief(space: StateSpace, n_members: int = 6, seed: int = 0) -> Ensemble:
    """Return members (N, n) of a space: positive numbers, and angles within [0, 2 pi)."""
    rng = np.random.default_rng([seed, n_members])
    members = np.abs(1.0 + 0.5 * rng.standard_normal((n_members, space.size)))
    return Ensemble(space.retract(members, np.zeros(space.size)), space, 2.0)


def gas_problem(direction: float, seed: int = 0, n_members: int = 20) -> Problem:
    """Return a problem of ``gas_space`` with winds around ``direction`` (rad) and readings far below the forecast's."""
    space, rng = gas_space(), np.random.default_rng([seed, 1])
    members = space.pack(
        {
            "concentration": 0.2 * rng.random((n_members, 12)),
            "wind_speed": rng.random(n_members),
            "wind_direction": np.mod(direction + 0.4 * rng.standard_normal(n_members), 2.0 * np.pi),
        }
    )
    matrix = np.eye(space.size)[[0, 5, 7, 12]]
    places = np.vstack([np.asarray(space["concentration"].coordinates)[[0, 5, 7]], [[0.0, 0.0]]])
    operator = Linear(matrix=matrix, covariance=np.full(4, 0.01), coordinates=places)
    return Problem(Ensemble(members, space, 1.0), operator, np.full(4, -0.3))


def positive_problem(seed: int = 0, n_members: int = 20) -> Problem:
    """Return a problem of three positive numbers, of which two are read, far below the forecast's."""
    places, rng = np.array([[0.0, 0.0], [100.0, 0.0], [200.0, 0.0]]), np.random.default_rng([seed, 2])
    space = StateSpace([Variable("rate", 3, POSITIVE, "s-1", places)])
    operator = Linear(matrix=np.eye(3)[:2], covariance=np.full(2, 0.01), coordinates=places[:2])
    members = np.exp(0.5 * rng.standard_normal((n_members, 3)))
    return Problem(Ensemble(members, space, 1.0), operator, np.full(2, -0.3))


def bounded_problems() -> list[Problem]:
    """Return problems whose readings pull the members out of the range of their variables."""
    return [*(gas_problem(direction, seed) for seed, direction in enumerate((0.05, 3.0, 6.25))), positive_problem()]


@cache
def airspace() -> Domain:
    """Return the rectangle of ``gas_space`` with a wide margin and one square building in its middle."""
    building = np.array([[130.0, 80.0], [170.0, 80.0], [170.0, 120.0], [130.0, 120.0]])
    return Domain((-20.0, -20.0, EAST + 20.0, NORTH + 20.0), (building,), ("square",))


def vehicles(n_vehicles: int, *, speed: float = 10.0, domain: Domain | None = None) -> Vehicle:
    """Return up to 3 vehicles around the building, 2 to 20 m from its walls."""
    places = np.array([[120.0, 100.0], [172.0, 118.0], [150.0, 60.0]])
    return Vehicle(places[:n_vehicles], speed, 1.0, domain)


def routes() -> list[Route]:
    """Return routes as they occur in studies: no vehicle, one that hovers, one that flies, two that fly.

    The last is flown in half a second, the others in one.
    """
    bent = np.array([[120.0, 100.0], [100.0, 100.0], [100.0, 90.0]])
    two = (bent, np.array([[10.0, 10.0], [40.0, 50.0]]))
    return [Route(dt=1.0), Route((bent[:1],), dt=1.0), Route((bent,), dt=1.0), Route(two, dt=1.0), Route(two, dt=0.5)]
