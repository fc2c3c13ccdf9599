"""Sensors that follow slowly: the law, the likelihood with several possible response times, and the twin's readings."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from dafw import ConfigurationError
from dafw.core.observation import Observation, Selection, nothing
from dafw.core.sensor_response import followed, reading_times
from dafw.core.space import Array
from dafw.plugins.filters.likelihood import Background, Likelihood
from dafw.plugins.filters.slow_sensors import as_shown, fit_of_slow_sensors, response_seen
from dafw.plugins.readings.twin import Twin

DT, R = 2.0, 0.01
NAMES = [("a", "a"), (), ("a", "b"), ("b", "a"), ("a",)]


def window(values: Array, names=NAMES, limits=None, variance=R) -> SimpleNamespace:
    """A window whose cycles have these readings in order."""
    cycles, first = [], 0
    for number, own in enumerate(names):
        size = len(own) if own is not None else 1
        part = slice(first, first + size)
        operator = (
            Selection(
                indices=np.arange(size),
                covariance=np.full(size, variance),
                sensors=own,
                limits=None if limits is None else limits[part],
            )
            if size
            else nothing()
        )
        observation = Observation(values[part], operator, (number + 1) * DT)
        cycles.append(SimpleNamespace(number=number, observation=observation))
        first += size
    return SimpleNamespace(cycles=cycles, forecast=SimpleNamespace(ensemble=SimpleNamespace(time=len(cycles) * DT)))


COUNT = sum(map(len, NAMES))
MET = np.random.default_rng(3).random((4, COUNT))
SENSORS = [name for own in NAMES for name in own]
TIMES = np.concatenate([reading_times(own, number * DT, (number + 1) * DT) for number, own in enumerate(NAMES)])


def test_a_sensor_takes_its_readings_of_a_cycle_at_equal_intervals():
    np.testing.assert_allclose(reading_times(("a", "b", "a", "a"), 10.0, 13.0), [11.0, 13.0, 12.0, 13.0])
    assert reading_times((), 0.0, 1.0).size == 0


def test_the_answer_to_a_step_is_the_exponential():
    times = np.array([0.5, 1.0, 3.0, 7.0])
    np.testing.assert_allclose(followed(np.ones(4), "aaaa", times, 2.0), 1.0 - np.exp(-times / 2.0), rtol=1e-14)
    one = np.ones((3, 4))
    assert followed(one, "aaaa", times, 0.0) is one


def test_sensors_do_not_know_of_each_other():
    together = followed(MET, SENSORS, TIMES, 3.0)
    for name in "ab":
        own = [number for number, other in enumerate(SENSORS) if other == name]
        np.testing.assert_array_equal(together[:, own], followed(MET[:, own], [name] * len(own), TIMES[own], 3.0))


def test_it_is_the_law_of_the_twin():
    twin, memory, shown = Twin(lag=3.0), {}, []
    for number, own in enumerate(NAMES):
        first = sum(map(len, NAMES[:number]))
        operator = Selection(
            indices=np.arange(first, first + len(own)), covariance=np.full(len(own), 1e-30), sensors=own
        )
        request = SimpleNamespace(
            operator=operator,
            start=number * DT,
            end=(number + 1) * DT,
            truth=SimpleNamespace(members=MET[:1]),
        )
        taken = twin.take_with_memory(request, memory, np.random.default_rng(0))
        memory = taken.memory
        shown.append(taken.observations[0].values)
    np.testing.assert_allclose(np.concatenate(shown), followed(MET[0], SENSORS, TIMES, 3.0), atol=1e-14)


def test_the_likelihood_is_that_of_what_is_shown():
    values = np.random.default_rng(4).random(COUNT)
    options = Likelihood(absolute=[0.0, 0.3], response_time=[0.0, 2.0, 6.0], independence=0.5)
    fit = fit_of_slow_sensors(window(values), MET, options)
    assert fit.shape == (4, 6) == (4, options.n_cases)
    for case, (time, absolute) in enumerate((time, size) for time in (0.0, 2.0, 6.0) for size in (0.0, 0.3)):
        missed = values - followed(MET, SENSORS, TIMES, time)
        expected = 0.5 * norm.logpdf(missed, scale=np.sqrt(R + absolute**2)).sum(axis=1)
        np.testing.assert_allclose(fit[:, case], expected, rtol=1e-12)


def test_a_reading_below_its_limit_says_so():
    limits = np.full(COUNT, np.nan)
    limits[2] = 0.2
    values = np.where(np.isnan(limits), followed(MET[0], SENSORS, TIMES, 2.0), 0.1)
    fit = fit_of_slow_sensors(window(values, limits=limits), MET[:1], Likelihood(response_time=[2.0]))
    variance = R - 0.2**2 / 12.0
    room = (0.2 - followed(MET[0], SENSORS, TIMES, 2.0)[2]) / np.sqrt(variance)
    expected = (COUNT - 1) * norm.logpdf(0.0, scale=np.sqrt(R)) + norm.logcdf(room)
    assert fit[0, 0] == pytest.approx(expected, rel=1e-10)


def test_the_response_time_is_found():
    options = Likelihood(response_time=[0.0, 1.0, 4.0, 16.0], absolute=[0.001, 0.01])
    values = followed(MET[1], SENSORS, TIMES, 4.0)
    seen = window(values, variance=1e-6)
    fit = fit_of_slow_sensors(seen, MET, options)
    weights = np.exp(options.averaged(fit) - options.averaged(fit).max())
    weights /= weights.sum()
    assert int(np.argmax(weights)) == 1
    assert response_seen(fit, weights, options)["response_time"].values == pytest.approx(4.0, abs=0.01)
    np.testing.assert_array_equal(as_shown(seen, MET, fit, weights, options), followed(MET, SENSORS, TIMES, 4.0))
    assert options.size_of_error(fit, weights).shape == (2,)


def test_without_slow_sensors_nothing_changes():
    options = Likelihood()
    assert as_shown(window(MET[0]), MET, MET, MET[0], options) is MET and response_seen(MET, MET[0], options) == {}
    assert not options.has_slow_sensors and options.n_cases == 1


def test_an_observer_that_does_not_tell_its_sensors_is_refused():
    with pytest.raises(ConfigurationError, match="which sensor takes a reading"):
        fit_of_slow_sensors(window(np.ones(1), [None]), np.ones((2, 1)), Likelihood(response_time=[3.0]))


@pytest.mark.parametrize("times", [[], [-1.0], [float("inf")], [True]])
def test_impossible_times_are_refused(times):
    with pytest.raises(ConfigurationError, match=r"likelihood.response_time must list one or more times"):
        Likelihood(response_time=times)


def test_backgrounds_and_slow_sensors_do_not_go_together():
    with pytest.raises(ConfigurationError, match=r"response_time cannot be used with background\.sd"):
        Likelihood(response_time=[0.0, 3.0], background=Background(sd=1.0))
