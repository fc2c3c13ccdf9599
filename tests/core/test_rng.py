"""Random streams are addressed by seed, role, cycle and member."""

import numpy as np
import pytest

from dafw.core.rng import Streams


def test_the_same_address_gives_the_same_bits():
    draws = [Streams(3).generator("policy", 5).standard_normal(10) for _ in range(2)]
    np.testing.assert_array_equal(*draws)


def test_every_part_of_the_address_matters():
    addresses = [
        (3, "policy", 5, 0),
        (4, "policy", 5, 0),
        (3, "filter", 5, 0),
        (3, "policy", 6, 0),
        (3, "policy", 5, 1),
    ]
    draws = {Streams(seed).generator(role, cycle, member).random() for seed, role, cycle, member in addresses}
    assert len(draws) == len(addresses)


def test_a_larger_ensemble_leaves_the_members_before_as_they_were():
    rng = Streams(0).members("model error", 2)
    np.testing.assert_array_equal(rng.standard_normal((9, 4))[:5], rng.standard_normal((5, 4)))


def test_a_batch_of_members_draws_what_they_draw_in_the_whole():
    rng = Streams(0).members("model error", 2)
    whole = rng.standard_normal((6, 3))
    np.testing.assert_array_equal(
        np.vstack([rng.standard_normal((2, 3)), rng.shifted(2).standard_normal((4, 3))]), whole
    )


def test_numbers_are_standard_normal_and_members_independent():
    drawn = Streams(1).members("model error", 0).standard_normal((4, 20_000))
    # five standard errors
    assert np.abs(drawn.mean(axis=1)).max() < 5 / np.sqrt(20_000)
    assert np.abs(np.cov(drawn) - np.eye(4)).max() < 5 * np.sqrt(2 / 20_000)


def test_members_are_counted_from_zero():
    with pytest.raises(IndexError):
        Streams(0).members("x", 0)[-1]


def test_one_number_a_member_may_be_asked_for_by_their_number():
    rng = Streams(0).members("model error", 2)
    np.testing.assert_array_equal(rng.standard_normal(4), rng.standard_normal((4,)))
