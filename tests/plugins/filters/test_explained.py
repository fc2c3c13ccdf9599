"""Whether a sample explains the readings: errors drawn as they are said to be do, larger ones do not."""

import numpy as np
import pytest
from levels import Levels, T

from dafw import Ensemble, Observation, Selection
from dafw.core.ensemble import Forecast
from dafw.core.window import PastCycle
from dafw.plugins.filters.candidates import Candidates
from dafw.plugins.filters.explained import is_explained
from dafw.plugins.filters.likelihood import Likelihood

SD = 0.2


class Seen:
    """A window of one cycle with these readings."""

    def __init__(self, values, limits=None):
        operator = Selection(
            indices=np.zeros(len(values), dtype=int),
            covariance=np.full(len(values), SD**2),
            limits=limits,
            sensors=("a",) * len(values),
        )
        self.values, self.covariance = values, operator.covariance
        belief = Forecast(Ensemble(np.zeros((1, 3)), Levels().space, float(T)))
        self.cycles, self.forecast = (PastCycle(0, belief, Observation(values, operator, 1.0)),), belief


def judged(values, predicted, likelihood, limits=None):
    """Return whether a sample that predicts ``predicted`` explains the readings; another one is far worse."""
    window = Seen(values, limits)
    both = np.stack([predicted + 100.0, predicted])
    covariance, ends = window.covariance, limits
    fit = np.tile(likelihood.log_density(both, values, covariance, ends), (1, len(likelihood.response_time)))
    zeros = np.zeros(2)
    samples = Candidates(np.zeros((2, 3)), np.zeros((2, 2)), zeros, zeros, zeros, fit, both, window.forecast)
    return is_explained(window, samples, likelihood)


LIKELIHOODS = {
    "normal": Likelihood(absolute=[0.1]),
    "student": Likelihood(absolute=[0.1], degrees_of_freedom=4.0),
    "relative": Likelihood(relative=[0.1, 0.3, 3.0]),
    "half": Likelihood(absolute=[0.1], degrees_of_freedom=4.0, independence=0.5),
    "several sizes": Likelihood(absolute=[0.01, 0.1, 0.5, 5.0], relative=[0.02, 0.1, 1.0], independence=0.5),
}


def errors(likelihood, size, rng):
    """Return errors of scale 1 as the likelihood has them."""
    degrees = likelihood.degrees_of_freedom
    return rng.standard_normal(size) if degrees is None else rng.standard_t(degrees, size)


@pytest.mark.parametrize("name", LIKELIHOODS)
@pytest.mark.parametrize("size", [5, 50, 800])
def test_errors_as_large_as_they_are_said_to_be_are_explained_and_larger_ones_are_not(name, size):
    likelihood, rng = LIKELIHOODS[name], np.random.default_rng(1000)
    # The largest of several sizes is not taken for an explanation (see below).
    absolute, relative = (
        size[-2] if len(size) > 2 else size[-1] for size in (likelihood.absolute, likelihood.relative)
    )
    right, wrong = [], []
    for _ in range(60):
        predicted = rng.uniform(0.5, 1.0, size)
        scale = np.sqrt(SD**2 + absolute**2 + (relative * predicted) ** 2)
        off = scale * errors(likelihood, size, rng)
        right.append(judged(predicted + off, predicted, likelihood))
        wrong.append(judged(predicted + 6.0 * off, predicted, likelihood))
    assert np.mean(right) > 0.85
    assert np.mean(wrong) < {5: 0.6, 50: 0.1, 800: 0.01}[size]


def test_readings_that_all_samples_miss_as_far_as_they_can_are_not_explained():
    """Five of eight readings show gas, of which the best sample knows nothing: each is missed by 1 / 0.3 of a scale."""
    likelihood = Likelihood(absolute=[0.001], relative=[0.3], degrees_of_freedom=4.0, independence=0.5)
    values = np.array([50.0, 30.0, 20.0, 40.0, 30.0, 0.0, 0.0, 0.0])
    assert not judged(values, np.zeros(8), likelihood)
    assert judged(values, 1.1 * values, likelihood)


def test_readings_below_a_limit_say_nothing_of_how_far_they_are_missed():
    likelihood = LIKELIHOODS["normal"]
    values, limits = np.concatenate([np.full(20, 2.0), np.zeros(380)]), np.full(400, np.nan)
    limits[20:] = 0.1
    missed = values - np.where(np.arange(400) < 20, 3.5 * np.hypot(SD, 0.1), 0.0)
    assert not judged(values, missed, likelihood, limits)
    below = Likelihood(absolute=[0.1], detection_limit=0.1)
    assert not judged(values, missed, below) and judged(values, values, below)


def test_slow_sensors_are_compared_as_they_show():
    slow = Likelihood(absolute=[0.01], response_time=[5.0])
    met = np.where(np.arange(40) < 20, 1.0, 0.0)
    window = Seen(met)
    from dafw.plugins.filters.slow_sensors import as_shown

    shown = as_shown(window, met[np.newaxis], np.zeros((1, 1)), np.ones(1), slow)[0]
    assert np.abs(shown - met).max() > 0.5
    for values, expected in ((shown, True), (met + 2.0, False)):
        window = Seen(values)
        zeros = np.zeros(1)
        fit = slow.log_density(shown[np.newaxis], values, window.covariance)
        one = Candidates(np.zeros((1, 3)), np.zeros((1, 2)), zeros, zeros, zeros, fit, met[np.newaxis], window.forecast)
        assert is_explained(window, one, slow) == expected


def test_without_readings_nothing_is_judged():
    assert judged(np.empty(0), np.empty(0), LIKELIHOODS["normal"])


@pytest.mark.parametrize(
    ("sizes", "expected"),
    [
        ({"relative": [0.01, 0.3]}, False),
        ({"relative": [0.01, 0.3, 3.0]}, True),
        ({"relative": [0.3]}, True),
        ({"absolute": [0.01, 0.3]}, False),
    ],
)
def test_what_takes_the_largest_of_several_errors_of_the_model_is_not_explained(sizes, expected):
    predicted = np.ones(200)
    errors = 0.35 * np.random.default_rng(1001).standard_normal(200)
    assert judged(predicted + errors, predicted, Likelihood(**sizes)) is expected
