"""Means of puffs along lines against independent sums, and exact answers of a steady plume."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from dafw.plugins.models.puffs.path_means import ages_to, path_means

AGES = np.array([4.0, 9.0])
LENGTHS = np.array([3.0, 7.0])
SHAPE = np.array([0.2, 1.3, 0.7, 0.4, 0.5, 0.6])  # turn, factor, s_0, h_0, spread, lift
TURBULENCE = np.array([[1.1, 0.3], [0.8, 0.4]])
CARRIED = np.array([[[3.0, 1.0], [8.0, 2.0]], [[2.0, 2.0], [5.0, 6.0]]])
LINE = np.array([6.0, -4.0, 0.6, 0.8, 12.0])
HEIGHT = 1.5


def puff(point, place, moment, number):
    """Return the concentration (g m^-3 per g) of a puff at a point of the line's height, from its formula."""
    turn, factor, wide, high, spread, lift = SHAPE
    age = AGES[number]
    s = np.hypot(wide, spread * TURBULENCE[moment, 0] * age)
    h = np.hypot(high, lift * TURBULENCE[moment, 1] * age)
    turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    centre = place + factor * turned @ CARRIED[moment, number]
    level = np.prod(norm.pdf(point, centre, s))
    return level * (norm.pdf(HEIGHT, 0.0, h) + norm.pdf(-HEIGHT, 0.0, h))


def test_the_mean_is_that_of_the_puffs_along_the_line():
    place = np.array([1.0, 2.0])

    def whole(along):
        point = LINE[:2] + along * LINE[2:4]
        return sum(LENGTHS[n] * puff(point, place, moment, n) for moment in range(2) for n in range(2)) / 2.0

    expected = quad(whole, 0.0, LINE[4], epsabs=1e-12)[0] / LINE[4]
    found = path_means(
        place[np.newaxis],
        SHAPE[np.newaxis],
        CARRIED,
        TURBULENCE,
        AGES,
        LENGTHS,
        LINE[np.newaxis],
        np.array([HEIGHT]),
        9e9,
    )
    assert found[0, 0] == pytest.approx(expected, rel=1e-3)  # puffs farther than four widths are left out
    assert found[0, 0] > 1e-4


def test_a_steady_plume_crosses_a_line_with_all_of_its_gas():
    """The mean along a long line across a steady wind U, over all heights, is what flows: 1 g/s over U and length."""
    ages, lengths = ages_to(60.0, 0.05, 0.002)
    carried = np.stack([2.0 * ages, np.zeros(ages.size)], axis=1)[np.newaxis]
    line = np.array([[40.0, -500.0, 0.0, 1.0, 1000.0]])
    shape = np.array([[0.0, 1.0, 0.6, 0.6, 0.0, 0.5]])  # puffs that only grow upwards
    heights = np.linspace(0.0, 60.0, 1201)
    profile = np.array(
        [
            path_means(
                np.zeros((1, 2)), shape, carried, np.array([[1.0, 0.3]]), ages, lengths, line, np.array([z]), 9e9
            )
            for z in heights
        ]
    ).ravel()
    assert np.trapezoid(profile, heights) * 1000.0 == pytest.approx(1.0 / 2.0, rel=2e-3)


def test_below_the_mixing_height_nothing_grows_any_more():
    arguments = (np.zeros((1, 2)), SHAPE[np.newaxis], CARRIED, TURBULENCE, AGES, LENGTHS, LINE[np.newaxis])
    low = path_means(*arguments, np.array([0.0]), 0.5)
    same = SHAPE.copy()
    same[3], same[5] = 0.5, 0.0
    fixed = path_means(arguments[0], same[np.newaxis], *arguments[2:], np.array([0.0]), 9e9)
    np.testing.assert_allclose(low, fixed, rtol=1e-12)


def test_ages_fill_the_time_and_their_intervals_grow():
    ages, lengths = ages_to(180.0, 0.5, 0.12)
    assert lengths.sum() == pytest.approx(180.0) and (np.diff(lengths[:-1]) > 0.0).all()
    np.testing.assert_allclose(ages - 0.5 * lengths, np.append(0.0, np.cumsum(lengths)[:-1]), atol=1e-9)
