"""Probabilities and quantiles of weighted members."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dafw.core.forecasts.chances import chance, exceeded
from dafw.core.quantiles import quantile

COUNTS = st.lists(st.integers(0, 5), min_size=1, max_size=8).filter(any)
VALUES = st.sampled_from([-1.0, 0.0, 0.5, 1.0, 3.0, np.inf])
SHARES = st.sampled_from([0.1, 0.25, 0.5, 0.75, 0.9, 1.0])


@settings(deadline=None)
@given(COUNTS, st.data(), SHARES)
def test_a_weight_counts_like_so_many_members(counts, data, share):
    values = np.array([[data.draw(VALUES)] for _ in counts])
    weights, repeated = np.array(counts) / sum(counts), np.repeat(values, counts, axis=0)
    assert quantile(values, weights, share) == quantile(repeated, None, share)
    assert chance(values > 0.5, weights) == pytest.approx(chance(repeated > 0.5, None))


@settings(deadline=None)
@given(COUNTS, st.data(), SHARES)
def test_a_quantile_is_the_least_member_whose_cumulated_weight_reaches_it(counts, data, share):
    values = np.array([data.draw(VALUES) for _ in counts])
    weights = np.array(counts) / sum(counts)
    found = quantile(values, weights, share)
    assert weights[values <= found].sum() >= share - 1e-9
    assert weights[values < found].sum() < share


@settings(deadline=None)
@given(COUNTS, st.data(), SHARES, st.sampled_from([-0.5, 0.0, 0.7, 2.0]))
def test_the_exceeded_value_is_above_a_threshold_just_where_the_probability_is(counts, data, share, limit):
    values = np.array([data.draw(VALUES) for _ in counts])
    weights = np.array(counts) / sum(counts)
    assert (exceeded(values, weights, share) > limit) == (chance(values > limit, weights) >= share - 1e-9)


def test_a_time_that_never_comes_is_later_than_all():
    times = np.array([[5.0, np.inf], [np.inf, np.inf], [7.0, 1.0], [6.0, np.inf]])
    np.testing.assert_array_equal(quantile(times, None, 0.5), [6.0, np.inf])
    np.testing.assert_array_equal(quantile(times, None, 0.25), [5.0, 1.0])
    np.testing.assert_array_equal(quantile(times, np.array([0.0, 0.0, 1.0, 0.0]), 0.9), [7.0, 1.0])
