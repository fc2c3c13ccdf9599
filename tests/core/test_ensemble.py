"""The values of a cycle: moments and quantiles with and without weights, and which arrays are read-only."""

import numpy as np
import pytest

from dafw import ANGLE, FIELD, POSITIVE, ContractError, Ensemble, Route, StateSpace, Variable, Vehicle
from dafw.core.ensemble import freeze

SPACE = StateSpace([Variable("level", 2, FIELD), Variable("rate", 1, POSITIVE), Variable("direction", 1, ANGLE)])


def draws(n_members, seed=0):
    rng = np.random.default_rng(seed)
    return SPACE.pack(
        {
            "level": rng.standard_normal((n_members, 2)),
            "rate": np.exp(rng.standard_normal(n_members)),
            "direction": np.mod(6.2 + 0.3 * rng.standard_normal(n_members), 2.0 * np.pi),
        }
    )


def test_equal_weights_say_what_no_weights_say():
    members = draws(6)
    plain, weighted = Ensemble(members, SPACE), Ensemble(members, SPACE, weights=np.full(6, 1 / 6))
    np.testing.assert_allclose(weighted.mean, plain.mean, rtol=1e-14)
    np.testing.assert_allclose(weighted.spread, plain.spread, rtol=1e-12)
    assert weighted.effective_size == pytest.approx(6.0) and plain.effective_size == 6.0


def test_a_weight_of_two_counts_like_two_members():
    members, weights = draws(4), np.array([0.4, 0.2, 0.2, 0.2])
    doubled = Ensemble(members[[0, 0, 1, 2, 3]], SPACE)
    weighted = Ensemble(members, SPACE, weights=weights)
    np.testing.assert_allclose(weighted.mean, doubled.mean, rtol=1e-14)
    biased = np.mean(doubled.anomalies**2, axis=0)
    np.testing.assert_allclose(weighted.variance * (1.0 - weights @ weights), biased, rtol=1e-12)


def test_one_member_with_all_the_weight_has_no_spread_and_is_the_mean():
    belief = Ensemble(draws(3), SPACE, weights=[0.0, 1.0, 0.0])
    np.testing.assert_allclose(belief.mean, belief.members[1])
    np.testing.assert_array_equal(belief.spread, 0.0)
    np.testing.assert_allclose(belief.quantile(0.1), belief.members[1])


@pytest.mark.parametrize("count", [9, 20, 100])
def test_with_equal_weights_a_quantile_is_the_first_member_that_reaches_it(count):
    space = StateSpace([Variable("x", 1)])
    belief = Ensemble(np.arange(1.0, count + 1)[:, np.newaxis], space, weights=np.full(count, 1 / count))
    found = [belief.quantile(k / count)[0] for k in range(1, count + 1)]
    np.testing.assert_allclose(found, np.arange(1.0, count + 1))


def test_a_member_without_weight_is_no_quantile():
    belief = Ensemble([[1.0], [2.0], [3.0], [4.0]], StateSpace([Variable("x", 1)]), weights=[0.0, 0.5, 0.5, 0.0])
    assert [belief.quantile(p)[0] for p in (0.0, 0.5, 0.6, 1.0)] == [2.0, 2.0, 3.0, 3.0]


def test_the_weighted_variance_is_that_of_the_density_it_samples():
    rng = np.random.default_rng(5)
    x = rng.uniform(-6.0, 6.0, 40_000)
    weights = np.exp(-0.5 * x**2)
    belief = Ensemble(x[:, np.newaxis], StateSpace([Variable("x", 1)]), weights=weights / weights.sum())
    assert belief.mean[0] == pytest.approx(0.0, abs=0.03) and belief.spread[0] == pytest.approx(1.0, abs=0.03)
    assert belief.quantile(0.05)[0] == pytest.approx(-1.645, abs=0.05)
    assert belief.effective_size < 20_000


def test_quantiles_of_angles_do_not_care_for_the_seam():
    space = StateSpace([Variable("direction", 1, ANGLE)])
    angles = np.mod(np.linspace(-0.4, 0.4, 9), 2.0 * np.pi)[:, np.newaxis]
    for turn in (0.0, 1.0, 3.0):
        turned = Ensemble(np.mod(angles + turn, 2.0 * np.pi), space)
        found = [turned.quantile(p) for p in (0.0, 0.25, 0.5, 1.0)]
        expected = np.array([[-0.4], [-0.2], [0.0], [0.4]]) + turn
        np.testing.assert_allclose(space.difference(np.array(found), expected), 0.0, atol=1e-12)


def test_a_positive_number_moves_in_its_logarithm():
    space = StateSpace([Variable("rate", 1, POSITIVE)])
    belief = Ensemble([[1.0], [4.0], [16.0]], space)
    assert belief.mean[0] == pytest.approx(4.0) and belief.spread[0] == pytest.approx(np.log(4.0))
    np.testing.assert_allclose(space.retract(belief.mean, belief.anomalies), belief.members)
    assert (space.retract(belief.members, np.full((3, 1), -100.0)) > 0.0).all()
    assert belief.quantile(0.5)[0] == pytest.approx(4.0)


def test_readings_are_averaged_with_the_same_weights():
    belief = Ensemble(draws(3), SPACE, weights=[0.5, 0.25, 0.25])
    np.testing.assert_allclose(belief.average(np.array([[1.0, 0.0], [2.0, 4.0], [4.0, 4.0]])), [2.0, 2.0])


def test_nobody_writes_into_a_belief_and_its_maker_keeps_what_is_his():
    mine = draws(3)
    belief = Ensemble(mine, SPACE, weights=np.full(3, 1 / 3))
    before = belief.members.copy()
    mine[0, 0] = 7.0
    np.testing.assert_array_equal(belief.members, before)
    with pytest.raises(ValueError, match="read-only"):
        belief.members[0, 0] = 7.0


def test_what_is_read_only_already_is_not_copied():
    belief = Ensemble(draws(3), SPACE)
    assert Ensemble(belief.members, SPACE).members is belief.members
    view = draws(6)[::2]
    view.setflags(write=False)
    frozen = freeze(view)
    assert frozen.flags.c_contiguous and not frozen.flags.writeable


@pytest.mark.parametrize("shape", [(3,), (2, 3), (1, 2, 2), (2, 2, 2)])
def test_points_that_are_not_in_the_plane_are_refused(shape):
    with pytest.raises(ContractError, match=r"the path of vehicle 0 must be points \(k, 2\) in metres, got the shape"):
        Route((np.zeros(shape),))
    with pytest.raises(ContractError, match=r"the positions of vehicles must be points \(k, 2\)"):
        Vehicle(np.zeros(shape))
