"""The Kalman filter in an ensemble: in the framework's loop it equals the analytical recursion."""

# ruff: noqa: N806  (the letters of the formulas)

import numpy as np
import pytest

from dafw.core.cycle import Parts, advance, start
from dafw.core.ensemble import Ensemble, Vehicle
from dafw.core.errors import ComputationError, ConfigurationError
from dafw.core.observation import Observation, ObservationOperator, Selection
from dafw.core.rng import Streams
from dafw.core.space import ANGLE, StateSpace, Variable
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.filters.kalman import Kalman, members_with
from dafw.plugins.models.linear_advection import LinearAdvection
from dafw.plugins.observers.grid import Grid
from dafw.plugins.policies.stationary import Stationary
from dafw.plugins.readings.twin import Twin

CYCLES = 60


def cycles(model, filter_, n_members):
    """Run the framework's loop; yield state and cycle, the start first."""
    observer = Grid(stride=6, noise_sd=0.4)
    parts = Parts(model, model, None, observer, Stationary(), filter_, Twin(), Streams(3))
    state = start(parts, n_members, Vehicle(np.empty((0, 2))))
    yield state, None
    for _ in range(CYCLES):
        cycle = advance(parts, state)
        state = cycle.state
        yield state, cycle


@pytest.mark.parametrize("courant", [1.0, 0.5])
def test_many_cycles_are_the_analytical_recursion(courant):
    n = 24
    model = LinearAdvection(cells=n, length=float(n), dt=courant, waves=12)
    M = model.step(np.eye(n), 0.0, Streams(0).members("", 0)).T
    H, R = np.eye(n)[::6], 0.4**2 * np.eye(4)
    for state, cycle in cycles(model, Kalman(), n + 6):
        members = state.belief.ensemble.members
        if cycle is None:
            x, P = members.mean(axis=0), np.cov(members, rowvar=False)
            continue
        x, P = M @ x, M @ P @ M.T
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        x, P = x + K @ (cycle.observation.values - H @ x), P - K @ H @ P
        np.testing.assert_allclose(members.mean(axis=0), x, rtol=0, atol=1e-10)
        np.testing.assert_allclose(np.cov(members, rowvar=False), P, rtol=0, atol=1e-10)


def test_the_etkf_cycles_through_the_same_moments():
    model = LinearAdvection(cells=24, length=24.0, waves=5)
    for (exact, _), (ensemble, _) in zip(cycles(model, Kalman(), 30), cycles(model, ETKF(), 30), strict=True):
        one, other = exact.belief.ensemble.members, ensemble.belief.ensemble.members
        np.testing.assert_allclose(other.mean(axis=0), one.mean(axis=0), rtol=0, atol=1e-10)
        np.testing.assert_allclose(np.cov(other, rowvar=False), np.cov(one, rowvar=False), rtol=0, atol=1e-10)


def test_members_carry_any_moments_exactly():
    rng = np.random.default_rng(0)
    mean, near = rng.normal(size=5), rng.normal(size=(9, 5))
    root = rng.normal(size=(5, 5))
    for covariance in (root @ root.T, root[:, :2] @ root[:, :2].T, np.zeros((5, 5))):
        members = members_with(mean, covariance, near - near.mean(axis=0))
        np.testing.assert_allclose(members.mean(axis=0), mean, rtol=0, atol=1e-13)
        np.testing.assert_allclose(np.cov(members, rowvar=False), covariance, rtol=0, atol=1e-12)


def test_members_with_their_own_moments_stay_where_they_are():
    members = np.random.default_rng(1).normal(size=(9, 5))
    mean = members.mean(axis=0)
    found = members_with(mean, np.cov(members, rowvar=False), members - mean)
    np.testing.assert_allclose(found, members, rtol=0, atol=1e-13)


def analyse(members, variables, operator):
    ensemble, rng = Ensemble(members, StateSpace(variables)), np.random.default_rng(0)
    observation = Observation(np.zeros(operator.size), operator)
    return Kalman().update(ensemble, operator.apply(ensemble.members), observation, None, rng)


def test_too_few_members_and_angles_are_refused():
    operator = Selection(indices=np.array([0]), covariance=np.ones(1))
    members = np.random.default_rng(0).normal(size=(4, 4))
    with pytest.raises(ConfigurationError, match=r"needs more members than the state has numbers \(4\).*has 4"):
        analyse(members, [Variable("u", 4)], operator)
    with pytest.raises(ConfigurationError, match="'direction' has angles or bounds"):
        analyse(members[:, :2], [Variable("u", 1), Variable("direction", 1, ANGLE)], operator)


class Square(ObservationOperator):
    def apply(self, members):
        return members[:, :1] ** 2


class Affine(ObservationOperator):
    def apply(self, members):
        return 2.0 * members[:, 1:2] + 3.0


def test_operators_may_be_affine_but_not_curved():
    members = np.random.default_rng(0).normal(size=(6, 3))
    with pytest.raises(ComputationError, match="linear observation operator"):
        analyse(members, [Variable("u", 3)], Square(covariance=np.ones(1)))
    # A reading of 0 with almost no error: 2 u_1 + 3 = 0.
    analysis = analyse(members, [Variable("u", 3)], Affine(covariance=np.array([1e-12])))
    np.testing.assert_allclose(analysis.members[:, 1], -1.5, rtol=0, atol=1e-5)
