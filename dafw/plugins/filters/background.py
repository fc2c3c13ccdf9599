"""How likely a sequence of readings is, if sensors have unknown backgrounds and gains and a source may be off.

A prediction h (above background, of a source that is on) and the reading y of sensor i at time t are related by ::

    y_i(t) = b_i(t) + g_i o(t) h_i(t) + error,    b_i(t + T) = b_i(t) + drift sqrt(T) xi,    o = 0 or 1

with standard normal xi and b_i(0) normal. The gain g_i is constant and normal around 1; it is 1 where ``gain_sd`` is 0.
o changes with the chance 1 - exp(-T / on_off) in a time T; at first both are equally likely. Given o, every pair (b_i,
g_i) has a Kalman filter of its own. Over the two values of o the filters are mixed before each step, as in the
interacting multiple model filter (Blom and Bar-Shalom 1988, doi:10.1109/9.1299): so neither backgrounds and gains nor
the times of a leak's beginning and end need be sampled. The error has the variance ::

    s^2 = R + a^2 + r^2 (o h_i)^2 + r^2 (mean of o h over the sensors)^2

The last term is there because a wind that is a little off moves a plume from one sensor to the next. Errors have a
Student t distribution if ``degrees_of_freedom`` is finite. Then a reading moves background and gain as much as its
weight (nu + 1) / (nu + z^2) says, at most 1, with z the misfit over its standard deviation: an outlier hardly moves
them.

The loops are compiled by numba.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import lgamma
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from dafw.core.space import Array

if TYPE_CHECKING:
    from dafw.core.window import PastCycle


@dataclass(frozen=True, eq=False)
class Judged:
    """What a sequence of readings says of P candidates, for S sizes of the model's error.

    fit         (P, S) log likelihood
    background  (P, S, n) of every sensor after the last reading
    gain        (P, S, n) of every sensor after the last reading
    on          (P, S) probability that the source is on
    expected    (P, S, n) what every sensor was expected to read in the last cycle, before it did; the mean of several
                readings, NaN for a sensor that did not read
    sensors     (n,) their names
    """

    fit: Array
    background: Array
    gain: Array
    on: Array
    expected: Array
    sensors: tuple[str, ...]


def judged(
    cycles: Sequence[PastCycle],
    predicted: Array,
    sizes: Array,
    mean: float,
    sd: float,
    drift: float,
    on_off: float,
    degrees: float,
    power: float,
    sensors: Sequence[str] = (),
    gain_sd: float = 0.0,
) -> Judged:
    """Return what the readings of all cycles say of candidates.

    Args:
        cycles: with their observations; a sensor is told by its name, or by its place in the observation.
        predicted: (P, M) of all readings, in the order of the cycles.
        sizes: (S, 2) absolute and relative sizes of the model's error.
        mean: of a background at first.
        sd: its standard deviation.
        drift: by how much it changes in a second, standard deviation.
        on_off: mean seconds between changes of the source; infinite: it is always on.
        degrees: of freedom of Student's t distribution; infinite: normal errors.
        power: of the likelihood.
        sensors: names of those that come first, whether they have read anything or not.
        gain_sd: standard deviation of a gain at first.
    """
    names = {name: place for place, name in enumerate(sensors)}
    sensor, number, times = [], [], [0.0]
    for cycle in cycles:
        seen = cycle.observation
        if not seen.values.size:
            continue
        times.append(seen.time)
        for place in range(seen.values.size):
            name = str(place) if seen.operator.sensors is None else seen.operator.sensors[place]
            sensor.append(names.setdefault(name, len(names)))
            number.append(len(times) - 2)
    observations = [cycle.observation for cycle in cycles if cycle.observation.values.size]
    variances = [one.covariance if one.covariance.ndim == 1 else np.diagonal(one.covariance) for one in observations]
    constant = 0.0
    if np.isfinite(degrees):
        constant = lgamma(0.5 * (degrees + 1.0)) - lgamma(0.5 * degrees) - 0.5 * np.log(degrees * np.pi)
    fit, background, gain, on, expected = _sequence(
        np.ascontiguousarray(predicted),  # for others numba would compile it again
        np.concatenate([one.values for one in observations]),
        np.concatenate(variances),
        np.array(sensor),
        np.searchsorted(np.array(number), np.arange(len(times))),
        np.diff(times),
        sizes,
        np.array([mean, sd**2, drift**2, gain_sd**2, on_off, degrees, power, constant]),
        len(names),
    )
    return Judged(fit, background, gain, on, expected, tuple(names))


@njit(cache=True)
def _sequence(
    predicted: np.ndarray,
    values: np.ndarray,
    variances: np.ndarray,
    sensor: np.ndarray,
    begins: np.ndarray,
    spans: np.ndarray,
    sizes: np.ndarray,
    numbers: np.ndarray,
    n_sensors: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return fit (P, S), background and gain (P, S, n), on (P, S) and expected (P, S, n).

    The readings of cycle c are those from ``begins[c]`` to before ``begins[c + 1]``.
    """
    mean, variance, drift, gain_variance, on_off, degrees, power, constant = numbers
    n_candidates, n_sizes = predicted.shape[0], sizes.shape[0]
    fit = np.zeros((n_candidates, n_sizes))
    background, gain = np.zeros((n_candidates, n_sizes, n_sensors)), np.zeros((n_candidates, n_sizes, n_sensors))
    expected = np.zeros((n_candidates, n_sizes, n_sensors))
    on = np.zeros((n_candidates, n_sizes))
    half_log = 0.5 * np.log(2.0 * np.pi)
    # For both values of o and each sensor: background, gain, their variances and covariance.
    b, g, bb, gg, bg = np.empty((5, 2, n_sensors))
    mixed_b, mixed_g, mixed_bb, mixed_gg, mixed_bg = np.empty((5, 2, n_sensors))
    chance, before, density = np.empty(2), np.empty(2), np.empty(2)
    count = np.zeros(n_sensors)  # of the readings of each sensor in the last cycle
    for m in range(begins[spans.size - 1], begins[spans.size]):
        count[sensor[m]] += 1.0
    for p in range(n_candidates):
        for size in range(n_sizes):
            absolute, relative = sizes[size, 0] ** 2, sizes[size, 1] ** 2
            b[:], g[:], bb[:], gg[:], bg[:] = mean, 1.0, variance, gain_variance, 0.0
            chance[0] = 0.0 if np.isinf(on_off) else 0.5
            chance[1] = 1.0 - chance[0]
            total = 0.0
            for cycle in range(spans.size):
                first, last = begins[cycle], begins[cycle + 1]
                change = 0.0 if np.isinf(on_off) else 1.0 - np.exp(-spans[cycle] / on_off)
                for o in range(2):
                    stay, come = (1.0 - change) * chance[o], change * chance[1 - o]
                    before[o] = stay + come
                    share = stay / before[o] if before[o] > 0.0 else 1.0
                    for i in range(n_sensors):
                        rest = 1.0 - share
                        mixed_b[o, i] = share * b[o, i] + rest * b[1 - o, i]
                        mixed_g[o, i] = share * g[o, i] + rest * g[1 - o, i]
                        b_1, b_2 = b[o, i] - mixed_b[o, i], b[1 - o, i] - mixed_b[o, i]
                        g_1, g_2 = g[o, i] - mixed_g[o, i], g[1 - o, i] - mixed_g[o, i]
                        mixed_bb[o, i] = share * (bb[o, i] + b_1**2) + rest * (bb[1 - o, i] + b_2**2)
                        mixed_bb[o, i] += drift * spans[cycle]
                        mixed_gg[o, i] = share * (gg[o, i] + g_1**2) + rest * (gg[1 - o, i] + g_2**2)
                        mixed_bg[o, i] = share * (bg[o, i] + b_1 * g_1) + rest * (bg[1 - o, i] + b_2 * g_2)
                usual = 0.0
                for m in range(first, last):
                    usual += predicted[p, m] / (last - first)
                for o in range(2):
                    for i in range(n_sensors):  # one by one: numba compiles assignments of whole arrays for seconds
                        b[o, i], g[o, i] = mixed_b[o, i], mixed_g[o, i]
                        bb[o, i], gg[o, i], bg[o, i] = mixed_bb[o, i], mixed_gg[o, i], mixed_bg[o, i]
                    density[o] = 0.0
                    for m in range(first, last):
                        i, h = sensor[m], o * predicted[p, m]
                        error = variances[m] + absolute + relative * (h**2 + (o * usual) ** 2)
                        missed = values[m] - b[o, i] - g[o, i] * h
                        of_gain = h * (2.0 * bg[o, i] + h * gg[o, i])
                        scale = bb[o, i] + of_gain + error
                        z = missed**2 / scale
                        if np.isinf(degrees):
                            density[o] += -0.5 * z - 0.5 * np.log(scale) - half_log
                        else:
                            density[o] += constant - 0.5 * np.log(scale) - 0.5 * (degrees + 1.0) * np.log1p(z / degrees)
                            error *= max(1.0, (degrees + z) / (degrees + 1.0))
                            scale = bb[o, i] + of_gain + error
                        if cycle == spans.size - 1:
                            expected[p, size, i] += before[o] * (mixed_b[o, i] + mixed_g[o, i] * h)
                        with_g = bg[o, i] + h * gg[o, i]
                        to_b, to_g = (bb[o, i] + h * bg[o, i]) / scale, with_g / scale
                        b[o, i] += to_b * missed
                        g[o, i] += to_g * missed
                        bb[o, i] = bb[o, i] * (1.0 - to_b) - to_b * h * bg[o, i]
                        bg[o, i] -= to_b * with_g
                        gg[o, i] -= to_g * with_g
                    density[o] *= power
                largest = max(density[0], density[1]) if before[0] > 0.0 else density[1]
                for o in range(2):
                    chance[o] = before[o] * np.exp(min(density[o] - largest, 0.0)) if before[o] > 0.0 else 0.0
                both = chance[0] + chance[1]
                total += largest + np.log(both)
                chance /= both
            fit[p, size], on[p, size] = total, chance[1]
            for i in range(n_sensors):
                background[p, size, i] = chance[0] * b[0, i] + chance[1] * b[1, i]
                gain[p, size, i] = chance[0] * g[0, i] + chance[1] * g[1, i]
                expected[p, size, i] = expected[p, size, i] / count[i] if count[i] > 0.0 else np.nan
    return fit, background, gain, on, expected
