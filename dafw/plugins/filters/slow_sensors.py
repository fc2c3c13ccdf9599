"""How likely readings are if sensors follow slowly what they meet, with one of several possible response times.

The predictions of a sample are what a sensor would meet. With the response time T it shows (sensor_response.py) ::

    shown(t + s) = met + (shown(t) - met) exp(-s / T)

which is compared with the readings. All times T, like all sizes of the model's error, are equally likely beforehand,
and the likelihood is averaged over them: so the response time is estimated.
"""

from __future__ import annotations

import numpy as np

from dafw.core.ensemble import Diagnostic
from dafw.core.errors import ConfigurationError
from dafw.core.observation import merged_observations
from dafw.core.sensor_response import followed, reading_times
from dafw.core.space import Array
from dafw.core.window import Window
from dafw.plugins.filters.likelihood import Likelihood, shares_of_cases


def fit_of_slow_sensors(window: Window, predicted: Array, likelihood: Likelihood) -> Array:
    """Return the log likelihood (P, T S) of all readings so far, for every response time and size of the error.

    ``predicted`` (P, M) is what the sensors would meet. Raises ConfigurationError if an observer does not tell which
    sensor takes a reading.
    """
    seen = [cycle.observation for cycle in window.cycles if cycle.observation.values.size]
    readings = merged_observations(seen, window.forecast.ensemble.time)
    sensors, times = _taken(window)
    columns = []
    for response in likelihood.response_time:
        shown = followed(predicted, sensors, times, response)
        columns.append(likelihood.log_density(shown, readings.values, readings.covariance, readings.operator.limits))
    return np.concatenate(columns, axis=1)


def as_shown(window: Window, predicted: Array, fit: Array, weights: Array, likelihood: Likelihood) -> Array:
    """Return what sensors with the most likely response time show (P, M), from what they would meet.

    ``fit`` (P, T S) and ``weights`` (P,) are those of the samples. Without slow sensors it is ``predicted`` itself.
    """
    if not likelihood.has_slow_sensors:
        return predicted
    best = int(np.argmax(_chances(fit, weights, likelihood)))
    return followed(predicted, *_taken(window), likelihood.response_time[best])


def response_seen(fit: Array, weights: Array, likelihood: Likelihood) -> dict[str, Diagnostic]:
    """Return the mean of the response time over weighted samples, for the record; nothing without slow sensors."""
    if not likelihood.has_slow_sensors:
        return {}
    mean = _chances(fit, weights, likelihood) @ np.array(likelihood.response_time)
    return {"response_time": Diagnostic(mean, units="s", long_name="estimated response time of the sensors")}


def _chances(fit: Array, weights: Array, likelihood: Likelihood) -> Array:
    """Return the probability (T,) of each response time."""
    return np.asarray((weights @ shares_of_cases(fit)).reshape(len(likelihood.response_time), -1).sum(axis=1))


def _taken(window: Window) -> tuple[list[str], Array]:
    """Return the sensor and the time in seconds of every reading of the window."""
    sensors: list[str] = []
    times = [np.empty(0)]
    dt = window.forecast.ensemble.time / (window.cycles[-1].number + 1)
    for cycle in window.cycles:
        size, names = cycle.observation.values.size, cycle.observation.operator.sensors
        if size and names is None:
            raise ConfigurationError(
                "likelihood.response_time needs to know which sensor takes a reading, which the observer does not "
                "tell (ObservationOperator.sensors)"
            )
        sensors += names or ()
        times.append(reading_times(names or (), cycle.number * dt, (cycle.number + 1) * dt))
    return sensors, np.concatenate(times)
