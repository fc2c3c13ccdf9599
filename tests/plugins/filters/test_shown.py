"""The members drawn from many samples: rare clouds are among them, and averages keep their expectation."""

import numpy as np
import pytest

from dafw import NONNEGATIVE, Ensemble, StateSpace, Variable
from dafw.plugins.filters.shown import members_drawn, similar

OFFSETS = (np.arange(2000) + 0.5) / 2000
GAS = StateSpace([Variable("gas", 6, NONNEGATIVE), Variable("speed", 1)])
PLAIN = StateSpace([Variable("level", 7)])
COMMON, RARE, EMPTY = [4.0, 2.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 3.0, 5.0], [0.0] * 6


def samples(n_common=38, n_rare=2, n_empty=0, space=GAS):
    clouds = [COMMON] * n_common + [RARE] * n_rare + [EMPTY] * n_empty
    return Ensemble(np.column_stack([clouds, np.arange(len(clouds), dtype=float)]), space)


def test_the_overlap_of_clouds():
    ensemble = Ensemble(
        [[*COMMON, 1.0], [*RARE, 1.0], [*(2.0 * np.array(COMMON)), 1.0], [*EMPTY, 1.0], [*EMPTY, 2.0]], GAS
    )
    weights = np.array([0.4, 0.3, 0.1, 0.15, 0.05])
    # A cloud of twice the gas overlaps by a half; empty ones are alike.
    np.testing.assert_allclose(similar(ensemble, weights), [0.45, 0.3, 0.3, 0.2, 0.2])


def test_a_state_without_clouds_is_drawn_in_proportion_to_the_weights():
    weights = np.random.default_rng(0).dirichlet(np.full(40, 5.0))
    assert weights.max() < 0.1
    ensemble = samples(space=PLAIN)
    np.testing.assert_array_equal(similar(ensemble, weights), np.ones(40))
    for offset in OFFSETS[::200]:
        np.testing.assert_allclose(members_drawn(ensemble, weights, 10, offset)[1], 0.1)


def test_a_rare_cloud_is_shown_with_the_square_root_of_its_weight():
    """The two rare samples weigh 1/20; drawn by weight, six in ten draws of ten members would not show them."""
    ensemble, weights = samples(), np.full(40, 1.0 / 40.0)
    shown = np.array([(members_drawn(ensemble, weights, 10, offset)[0] >= 38).sum() for offset in OFFSETS])
    expected = 10.0 * np.sqrt(0.05) / (np.sqrt(0.05) + np.sqrt(0.95))
    assert shown.mean() == pytest.approx(expected, abs=0.01)
    assert shown.min() >= 1


@pytest.mark.parametrize("space", [GAS, PLAIN], ids=["clouds", "no clouds"])
def test_averages_keep_their_expectation_and_no_sample_is_repeated(space):
    ensemble = samples(30, 4, 6, space)
    rng = np.random.default_rng(3)
    weights, values = rng.dirichlet(np.ones(40)), rng.normal(size=40)
    total, of_weights = 0.0, np.zeros(40)
    for offset in OFFSETS:
        drawn, shares = members_drawn(ensemble, weights, 12, offset)
        assert len(set(drawn.tolist())) == 12
        assert shares.sum() == pytest.approx(1.0)
        of_weights[drawn] += shares / len(OFFSETS)
        total += shares @ values[drawn] / len(OFFSETS)
    # They add up to one in every draw, which costs a little: the ratio of two unbiased sums.
    np.testing.assert_allclose(of_weights, weights, atol=2e-3)
    assert total == pytest.approx(weights @ values, abs=2e-3)


def test_with_the_same_offset_most_members_stay():
    ensemble, rng = samples(30, 10), np.random.default_rng(5)
    weights = rng.dirichlet(np.ones(40))
    later = weights * np.exp(0.02 * rng.normal(size=40))
    first, second = (set(members_drawn(ensemble, each / each.sum(), 10, 0.37)[0]) for each in (weights, later))
    assert len(first & second) >= 7


def test_too_few_samples_are_taken_several_times():
    weights = np.array([0.5, 0.3, 0.2])
    drawn, shares = members_drawn(samples(2, 1), weights, 5, 0.4)
    assert sorted(drawn.tolist()) == [0, 0, 1, 1, 2]
    np.testing.assert_allclose(np.bincount(drawn, weights=shares), weights)
