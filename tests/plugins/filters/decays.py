"""Small models whose controls are known, and studies of them, for the filters that run the model again."""

from dataclasses import dataclass, field

import numpy as np
from filterpy.kalman import KalmanFilter, rts_smoother

from dafw import Model, StateSpace, Step, Study, Variable
from dafw.core.errors import DivergenceError, SolverError, about_member
from dafw.core.space import POSITIVE
from dafw.plugins.filters.rotation import zero_mean_basis
from dafw.plugins.readings.listed import Listed


def exact_draws(n_members, mean, covariance):
    """Return members (N, n) whose sample mean and covariance are exactly these."""
    columns = zero_mean_basis(n_members)[:, : len(covariance)]
    return mean + np.sqrt(n_members - 1) * columns @ np.linalg.cholesky(covariance).T


def covariance(ensemble):
    """Return the sample covariance (n, n)."""
    return ensemble.anomalies.T @ ensemble.anomalies / (len(ensemble) - 1)


def listed(values, sd, silent=(), late=(), span=0.0):
    """Return readings of the first number of the state, one a cycle; the ``late`` ones arrive with the last.

    Each is a mean over ``span`` seconds.
    """
    return Listed(
        readings=[
            {"time": cycle + 1.0, "value": float(value), "entry": 0, "sd": sd}
            | ({"span": span} if span else {})
            | ({"arrives": float(len(values))} if cycle in late else {})
            for cycle, value in enumerate(values)
            if cycle not in silent
        ]
    )


def cycles_of(model, filter_, readings, n_cycles, members, **options):
    """Return all cycles of a study."""
    return list(Study(model=model, filter=filter_, readings=readings, members=members, cycles=n_cycles, **options))


# A linear model ------------------------------------------------------------------------------------------------------

F = np.array([[1.0, 0.5], [-0.3, 0.9]])
P0 = np.array([[2.0, 0.3], [0.3, 1.0]])
MEAN = np.array([1.0, -2.0])
SD, N, CYCLES, SILENT = 0.7, 12, 8, {2, 5}
VALUES = np.random.default_rng(3).normal(0.0, 2.0, CYCLES)


@dataclass
class Linear(Model):
    """x <- F x."""

    members: np.ndarray
    dt: float = 1.0
    space: StateSpace = field(default_factory=lambda: StateSpace([Variable("level", 2)]))

    def initial(self, n_members, rng):
        return self.members

    def step(self, members, t, rng):
        return members @ F.T


def linear_cycles(filter_, silent=SILENT, late=(), members=None):
    """Return the cycles of the linear study; the first belief has exactly the moments MEAN and P0."""
    members = exact_draws(N, MEAN, P0) if members is None else members
    return cycles_of(Linear(members), filter_, listed(VALUES, SD, silent, late), CYCLES, len(members))


def rauch_tung_striebel(known, until):
    """Return means (T + 1, 2) and covariances of the states after 0 ... ``until`` cycles, given those ``known``."""
    engine = KalmanFilter(dim_x=2, dim_z=1)
    engine.x, engine.P, engine.F, engine.Q = MEAN[:, np.newaxis].copy(), P0.copy(), F, np.zeros((2, 2))
    engine.H, engine.R = np.array([[1.0, 0.0]]), np.array([[SD**2]])
    means, covariances = [engine.x.copy()], [engine.P.copy()]
    for cycle in range(until):
        engine.predict()
        if cycle in known:
            engine.update(np.array([[VALUES[cycle]]]))
        means.append(engine.x.copy())
        covariances.append(engine.P.copy())
    size = len(means)
    matrices = np.array([engine.F] * size), np.array([engine.Q] * size)
    smoothed, spreads, *_ = rts_smoother(np.array(means), np.array(covariances), *matrices)
    return smoothed[:, :, 0], spreads


def require_moments(ensemble, expected, tolerance=1e-9):
    """Require a mean (2,) and a covariance (2, 2)."""
    np.testing.assert_allclose(ensemble.mean, expected[0], rtol=0, atol=tolerance)
    np.testing.assert_allclose(covariance(ensemble), expected[1], rtol=0, atol=tolerance)


@dataclass
class Pair(Linear):
    """The same with two variables, of which one alone can be estimated."""

    space: StateSpace = field(default_factory=lambda: StateSpace([Variable("left", 1), Variable("right", 1)]))


# A decay -------------------------------------------------------------------------------------------------------------


@dataclass
class Decay(Model):
    """An amount decays at a rate, both positive; the model remembers how many steps a member has taken.

    It cannot be solved for rates above ``limit``: ``fault`` is the error, which names the member or does not.
    """

    limit: float = np.inf
    fault: str = "member"
    start: np.ndarray | None = None
    dt: float = 1.0
    space: StateSpace = field(
        default_factory=lambda: StateSpace([Variable("amount", 1, POSITIVE), Variable("rate", 1, POSITIVE)])
    )

    def initial(self, n_members, rng):
        if self.start is not None:
            return self.start
        return np.exp(rng.draw(n_members, lambda one: [0.3, -1.5] + one.standard_normal(2) * [0.3, 0.5]))

    def initial_memory(self, members):
        return {"steps": np.zeros(len(members))}

    def step_with_memory(self, members, memory, t, rng):
        for member in np.flatnonzero(members[:, 1] > self.limit):
            if self.fault != "member":
                raise DivergenceError("some rate is too large")
            with about_member(int(member)):
                raise SolverError("the rate is too large")
        return Step(
            np.column_stack([members[:, 0] * np.exp(-members[:, 1]), members[:, 1]]), {"steps": memory["steps"] + 1.0}
        )


AMOUNTS = 1.4 * np.exp(-0.45 * np.arange(1, 7))
"""Six readings of a decay from an amount of 1.4 at a rate of 0.45."""


def decay_cycles(filter_, model=None, members=10, sd=0.02, **options):
    """Return the six cycles of a study of the decay."""
    return cycles_of(model or Decay(), filter_, listed(AMOUNTS, sd), len(AMOUNTS), members, **options)
