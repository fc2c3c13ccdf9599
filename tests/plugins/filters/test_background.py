"""The likelihood of a sequence with unknown backgrounds and gains, of a source on and off, against exact answers."""

from __future__ import annotations

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm, t

from dafw import ConfigurationError
from dafw.core.observation import Observation, Selection
from dafw.plugins.filters.background import judged
from dafw.plugins.filters.likelihood import Background, Likelihood

RNG = np.random.default_rng(5)
TIMES = np.array([1.0, 2.0, 4.0, 5.0, 9.0])
SENSORS = [("a", "b"), ("b",), ("a", "b"), (), ("b", "a")]
R = 0.04


def cycles(values, sensors=SENSORS, times=TIMES, variance=R):
    """Return cycles whose observations have these values, in order."""
    found, first = [], 0
    for number, (names, time) in enumerate(zip(sensors, times, strict=True)):
        size = len(names)
        operator = Selection(indices=np.arange(size), covariance=np.full(size, variance), sensors=tuple(names))
        found.append(
            SimpleNamespace(number=number, observation=Observation(values[first : first + size], operator, time))
        )
        first += size
    return found


COUNT = sum(map(len, SENSORS))
VALUES = RNG.normal(2.0, 0.5, COUNT)
PREDICTED = RNG.random((3, COUNT))
SIZES = np.array([[0.0, 0.0], [0.3, 0.0]])


def test_without_switching_it_is_the_density_of_a_random_walk_and_noise():
    names = [name for group in SENSORS for name in group]
    when = np.repeat(TIMES, [len(group) for group in SENSORS])
    same = np.equal.outer(names, names)
    walk = np.where(same, 0.5**2 + 0.2**2 * np.minimum.outer(when, when), 0.0)
    found = judged(cycles(VALUES), PREDICTED, SIZES, 1.8, 0.5, 0.2, np.inf, np.inf, 1.0)
    for column, (absolute, _) in enumerate(SIZES):
        covariance = walk + (R + absolute**2) * np.eye(COUNT)
        expected = [multivariate_normal(1.8 + one, covariance).logpdf(VALUES) for one in PREDICTED]
        np.testing.assert_allclose(found.fit[:, column], expected, rtol=1e-10)
    assert (found.on == 1.0).all() and found.sensors == ("a", "b")


def test_the_background_is_the_mean_given_all_readings():
    names = [name for group in SENSORS for name in group]
    when = np.repeat(TIMES, [len(group) for group in SENSORS])
    walk = np.where(np.equal.outer(names, names), 0.25 + 0.04 * np.minimum.outer(when, when), 0.0)
    gain = np.linalg.inv(walk + R * np.eye(COUNT))
    found = judged(cycles(VALUES), PREDICTED, SIZES[:1], 1.8, 0.5, 0.2, np.inf, np.inf, 1.0)
    for sensor, name in enumerate("ab"):
        now = np.where([one == name for one in names], 0.25 + 0.04 * np.minimum(when, TIMES[-1]), 0.0)
        expected = [1.8 + now @ gain @ (VALUES - 1.8 - one) for one in PREDICTED]
        np.testing.assert_allclose(found.background[:, 0, sensor], expected, rtol=1e-10)


def test_a_gain_is_one_more_number_of_a_joint_normal_distribution():
    names = [name for group in SENSORS for name in group]
    when = np.repeat(TIMES, [len(group) for group in SENSORS])
    same = np.equal.outer(names, names)
    walk = np.where(same, 0.5**2 + 0.2**2 * np.minimum.outer(when, when), 0.0)
    found = judged(cycles(VALUES), PREDICTED, SIZES[:1], 1.8, 0.5, 0.2, np.inf, np.inf, 1.0, gain_sd=0.3)
    for row, one in enumerate(PREDICTED):
        covariance = walk + np.where(same, 0.3**2 * np.outer(one, one), 0.0) + R * np.eye(COUNT)
        assert found.fit[row, 0] == pytest.approx(multivariate_normal(1.8 + one, covariance).logpdf(VALUES), rel=1e-10)
        for sensor, name in enumerate("ab"):
            with_gain = np.where([other == name for other in names], 0.3**2 * one, 0.0)
            expected = 1.0 + with_gain @ np.linalg.solve(covariance, VALUES - 1.8 - one)
            assert found.gain[row, 0, sensor] == pytest.approx(expected, rel=1e-10)


def test_a_gain_is_learnt_while_the_source_is_on():
    """A sensor that shows 1.5 times the gas; without gas it says nothing of its gain."""
    predicted = np.array([[0.0, 2.0, 3.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0, 0.0]])
    one = cycles(2.0 + 1.5 * predicted[0], [("a",)] * 5, variance=1e-6)
    found = judged(one, predicted, SIZES[:1], 2.0, 0.01, 0.0, 1e3, 4.0, 1.0, gain_sd=0.5)
    assert found.gain[0, 0, 0] == pytest.approx(1.5, abs=0.01) and found.gain[1, 0, 0] == 1.0
    known = judged(one, predicted, SIZES[:1], 2.0, 0.01, 0.0, 1e3, 4.0, 1.0)
    assert (known.gain == 1.0).all() and found.fit[0, 0] > known.fit[0, 0] + 5.0


def test_a_source_that_is_on_and_off_is_the_sum_over_all_sequences():
    """With known backgrounds the mixture is exact: 2^T sequences of on and off."""
    mean, on_off, relative = 1.9, 3.0, 0.4
    sizes = np.array([[0.1, relative]])
    found = judged(cycles(VALUES), PREDICTED, sizes, mean, 1e-9, 0.0, on_off, 4.0, 0.7)
    used = [number for number, group in enumerate(SENSORS) if group]
    spans = np.diff(np.append(0.0, TIMES[used]))
    groups = np.split(np.arange(COUNT), np.cumsum([len(SENSORS[number]) for number in used])[:-1])
    for row, predicted in enumerate(PREDICTED):
        likelihoods, ends_on = [], []
        for sequence in product((0, 1), repeat=len(used)):
            chance, before = 0.5 * (1.0), None
            density = 0.0
            for o, span, group in zip(sequence, spans, groups, strict=True):
                change = 1.0 - np.exp(-span / on_off)
                if before is not None:
                    chance *= change if o != before else 1.0 - change
                before = o
                h = o * predicted[group]
                scale = np.sqrt(R + 0.01 + relative**2 * (h**2 + h.mean() ** 2))
                density += 0.7 * t(4.0).logpdf((VALUES[group] - mean - h) / scale).sum() - 0.7 * np.log(scale).sum()
            likelihoods.append(chance * np.exp(density))
            ends_on.append(sequence[-1])
        total = np.sum(likelihoods)
        assert found.fit[row, 0] == pytest.approx(np.log(total), rel=1e-9)
        assert found.on[row, 0] == pytest.approx(np.array(likelihoods) @ ends_on / total, rel=1e-9)


def test_expected_readings_are_those_before_the_last_ones_came():
    """One sensor, one reading: what is expected is the first guess, whatever the reading says."""
    one = cycles(np.array([9.0]), [("a",)], [1.0])
    found = judged(one, np.array([[0.6]]), SIZES[:1], 1.9, 0.3, 0.0, 1e9, np.inf, 1.0)
    assert found.expected[0, 0, 0] == pytest.approx(1.9 + 0.5 * 0.6)
    assert found.on[0, 0] == pytest.approx(
        1.0 / (1.0 + norm.pdf(7.1, 0.0, np.sqrt(0.13)) / norm.pdf(6.5, 0.0, np.sqrt(0.13))), abs=1e-12
    )


def test_a_sensor_that_reads_several_times_in_a_cycle_is_expected_to_read_their_mean():
    several = cycles(np.array([9.0, 2.0, 3.0, 5.0, 1.0]), [("a", "b"), ("a", "b", "a")], [1.0, 2.0])
    predicted = np.array([[0.1, 0.2, 0.3, 0.4, 0.8], [1.0, 2.0, 3.0, 4.0, 7.0]])
    # The background is known. In a second the source changes with the chance 1/2, so that on and off stay as likely.
    found = judged(several, predicted, SIZES[:1], 1.9, 1e-9, 0.0, 1.0 / np.log(2.0), np.inf, 1.0)
    np.testing.assert_allclose(found.expected[:, 0], 1.9 + 0.5 * np.array([[0.55, 0.4], [5.0, 4.0]]), rtol=1e-9)
    always = judged(several, predicted, SIZES[:1], 1.9, 1e-9, 0.0, np.inf, np.inf, 1.0)
    np.testing.assert_allclose(always.expected[:, 0], 1.9 + np.array([[0.55, 0.4], [5.0, 4.0]]), rtol=1e-9)


def test_an_outlier_hardly_moves_a_background():
    values = np.array([2.0, 2.0, 2.0, 40.0, 2.0])
    quiet = cycles(values, [("a",)] * 5)
    plain, heavy = (
        judged(quiet, np.zeros((1, 5)), SIZES[:1], 2.0, 0.2, 0.01, np.inf, degrees, 1.0).background[0, 0, 0]
        for degrees in (np.inf, 4.0)
    )
    assert plain > 3.0 and abs(heavy - 2.0) < 0.05


def test_sensors_that_begin_late_have_their_place():
    found = judged(cycles(VALUES), PREDICTED, SIZES, 1.8, 0.5, 0.2, np.inf, np.inf, 1.0, ["c", "b", "a"])
    assert found.sensors == ("c", "b", "a") and found.background.shape == (3, 2, 3)
    assert (found.background[..., 0] == 1.8).all() and np.isnan(
        judged(
            cycles(VALUES[:3], SENSORS[:2], TIMES[:2]),
            PREDICTED[:, :3],
            SIZES,
            1.8,
            0.5,
            0.2,
            9.0,
            4.0,
            1.0,
            ["c", "b", "a"],
        ).expected[..., 0]
    ).all()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"background": Background(on_off=5.0)}, "on_off needs background.sd"),
        ({"background": Background(gain_sd=0.2)}, "gain_sd needs background.sd"),
        ({"background": Background(sd=1.0), "detection_limit": 3.0}, "detection_limit cannot be used"),
    ],
)
def test_options_that_do_not_go_together_are_refused(options, said):
    with pytest.raises(ConfigurationError, match=said):
        Likelihood(**options)
