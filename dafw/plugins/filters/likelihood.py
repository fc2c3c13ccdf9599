"""How likely readings are under a member's prediction: errors of the reading and of the model, heavy tails, zeros.

For a reading y with error variance R and a prediction h, the misfit is scaled by ::

    s^2 = R + a^2 + (r max(|h|, |y|))^2

a and r are the absolute and relative sizes of the model's error. If several sizes are listed, every pair (a, r) is
possible and all are equally likely beforehand; the likelihood is averaged over them. So the size is estimated: small
in a twin experiment whose truth is the model, large where the model cannot follow the truth.

(y - h) / s has a Student t distribution of ``degrees_of_freedom``, or a normal one. Readings a second apart share the
model's error: each counts only as ``independence`` of a reading, that is, the likelihood is raised to that power.
With ``background.sd`` every sensor has an unknown background that drifts, and may have an unknown gain; the source may
be on and off. The likelihood is then that of the whole sequence of readings (background.py), whose errors are relative
to the prediction.

If sensors are slow, one of several ``response_time`` is estimated likewise (slow_sensors.py).

A reading below ``detection_limit``, or below the limit that it has itself, says only that the truth is below it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dafw.core.ensemble import Diagnostic
from dafw.core.errors import ConfigurationError
from dafw.core.options import option
from dafw.core.space import Array

if TYPE_CHECKING:
    from dafw.core.window import PastCycle, Window
    from dafw.plugins.filters.background import Judged

SMALLEST_SHARE = 1e-12
"""Share of a variance that is left at least where rounding would take all of it."""


@dataclass
class Background:
    """What sensors read beside the gas of the source, in units of the readings."""

    mean: float = option(0.0, "first guess of a sensor's background")
    sd: float | None = option(None, "its standard deviation; null: there is no background", above=0.0)
    drift: float = option(0.0, "standard deviation of its change in a second; grows with the root of time", minimum=0.0)
    gain_sd: float | None = option(
        None,
        "standard deviation of each sensor's gain, a factor around 1 on the gas of the source; null: it is 1",
        above=0.0,
    )
    on_off: float | None = option(
        None, "mean seconds from one change of the source, on or off, to the next; null: it is always on", above=0.0
    )
    sensors: list[str] = option(
        [], "names of the sensors, in the order of the record; must be given if some begin to read later than others"
    )


@dataclass
class Likelihood:
    """Options of the likelihood, and its evaluation."""

    absolute: list[float] = option([0.0], "possible sizes of the model's error, in units of the readings")
    relative: list[float] = option([0.0], "sizes of the model's error relative to the larger of reading and prediction")
    degrees_of_freedom: float | None = option(
        None, "of the Student t distribution of the errors; null: normal distribution", above=0.0
    )
    independence: float = option(1.0, "power of the likelihood; below 1 for correlated errors", above=0.0, maximum=1.0)
    detection_limit: float | None = option(
        None, "a reading below it means only: less than this; null: only readings with a limit of their own mean so"
    )
    response_time: list[float] = option(
        [0.0], "possible time constants of sensors that follow slowly what they meet, s; 0: at once"
    )
    background: Background = option(Background, "unknown backgrounds of the sensors, and a source that is on and off")

    def __post_init__(self) -> None:
        for name in ("absolute", "relative"):
            sizes = getattr(self, name)
            if not sizes or any(isinstance(size, bool) or not size >= 0.0 for size in sizes):
                raise ConfigurationError(f"likelihood.{name} must list one or more sizes of at least 0, got {sizes}")

        times = self.response_time
        if not times or any(isinstance(time, bool) or not 0.0 <= time < np.inf for time in times):
            raise ConfigurationError(
                f"likelihood.response_time must list one or more times of at least 0 s, got {times}"
            )
        if self.background.sd is None:
            for name in ("on_off", "gain_sd"):
                if getattr(self.background, name) is not None:
                    raise ConfigurationError(
                        f"likelihood.background.{name} needs background.sd, the sensors' backgrounds"
                    )
            return
        if self.detection_limit is not None:
            raise ConfigurationError(
                f"likelihood.detection_limit cannot be used with background.sd, got {self.detection_limit:g}"
            )
        if self.has_slow_sensors:
            raise ConfigurationError(f"likelihood.response_time cannot be used with background.sd, got {times}")

    @property
    def has_background(self) -> bool:
        """Whether sensors have unknown backgrounds, so that only the sequence of all readings can be judged."""
        return self.background.sd is not None

    @property
    def has_slow_sensors(self) -> bool:
        """Whether sensors may follow slowly, so that a reading depends on what was met before."""
        return any(time > 0.0 for time in self.response_time)

    @property
    def n_cases(self) -> int:
        """How many pairs of sizes there are for all response times, T S: the columns of a sample's ``fit``."""
        return len(self.response_time) * len(self.sizes)

    def of_sequence(self, cycles: Sequence[PastCycle], predicted: Array) -> Judged:
        """Return what the readings of all cycles say of candidates that predict ``predicted`` (P, M)."""
        from dafw.plugins.filters.background import judged

        options, degrees = self.background, self.degrees_of_freedom
        return judged(
            cycles,
            predicted,
            self.sizes,
            options.mean,
            options.sd or 0.0,
            options.drift,
            np.inf if options.on_off is None else options.on_off,
            np.inf if degrees is None else degrees,
            self.independence,
            options.sensors,
            options.gain_sd or 0.0,
        )

    def seen(self, window: Window, predicted: Array, fit: Array, weights: Array) -> dict[str, Diagnostic]:
        """Return averages over weighted candidates, for the record: of backgrounds, gains, the source, readings.

        The arguments are as in ``Candidates``, with ``weights`` (P,). Without backgrounds there is nothing.
        """
        if not self.has_background:
            return {}
        found = self.of_sequence(window.cycles, predicted)
        share = shares_of_cases(fit) * weights[:, np.newaxis]
        background, expected = np.tensordot(share, found.background, 2), np.tensordot(share, found.expected, 2)
        names = ", ".join(found.sensors)
        gains = {}
        if self.background.gain_sd is not None:
            gain = np.tensordot(share, found.gain, 2)
            gains["gain"] = Diagnostic(gain, ("with_background",), long_name=f"gain of the sensors {names}")
        return gains | {
            "background": Diagnostic(background, ("with_background",), long_name=f"background of the sensors {names}"),
            "expected": Diagnostic(
                expected, ("with_background",), long_name=f"what was expected of the sensors {names}"
            ),
            "source_on": Diagnostic(np.sum(share * found.on), long_name="probability that the source is on"),
        }

    @property
    def sizes(self) -> Array:
        """All pairs (S, 2) of absolute and relative sizes of the model's error."""
        return np.array([(a, r) for a in self.absolute for r in self.relative], dtype=np.float64)

    def log_density(self, predicted: Array, values: Array, covariance: Array, limits: Array | None = None) -> Array:
        """Return the log likelihood (N, S) of the readings, for every member and every pair of ``sizes``.

        predicted    (N, m) what the members predict
        values       (m,) the readings
        covariance   (m,) or (m, m) R; with a full matrix the misfits are decorrelated before they are judged
        limits       (m,) of readings that were below a detection limit of their own, as in ``ObservationOperator``

        Raises ConfigurationError for a detection limit with a full R.
        """
        from scipy.special import gammaln

        ends = np.full(len(values), np.nan) if limits is None else limits
        if (own := ~np.isnan(ends)).any() and covariance.ndim == 1:
            # The value stands midway between the limit and what the sensor calls zero, with the variance that any
            # place between the two has (``below_limit``): that is taken off again, because the chance says it.
            added = (ends[own] - values[own]) ** 2 / 3.0
            covariance = covariance.copy()
            covariance[own] = np.maximum(covariance[own] - added, SMALLEST_SHARE * covariance[own])
        if self.detection_limit is not None:
            ends = np.where(~own & (values < self.detection_limit), self.detection_limit, ends)
        below = ~np.isnan(ends)
        missed = values - predicted
        absolute, relative = self.sizes.T[:, :, np.newaxis, np.newaxis]
        # Of a reading below a limit the limit is known, not the value.
        of_model = _of_model(absolute, relative, predicted, np.where(below, ends, values))  # (S, N, m)
        if covariance.ndim == 1:
            scale = np.sqrt(covariance + of_model)
            misfit = missed / scale
        else:
            root = np.linalg.cholesky(covariance + of_model[..., np.newaxis] * np.eye(len(values)))
            scale = np.diagonal(root, axis1=-2, axis2=-1)
            whole = np.broadcast_to(missed[..., np.newaxis], (*of_model.shape, 1))
            misfit = np.linalg.solve(root, whole)[..., 0]
        degrees = self.degrees_of_freedom
        if degrees is None:
            density = -0.5 * misfit**2 - np.log(scale) - 0.5 * np.log(2.0 * np.pi)
        else:
            constant = gammaln(0.5 * (degrees + 1.0)) - gammaln(0.5 * degrees) - 0.5 * np.log(degrees * np.pi)
            density = constant - np.log(scale) - 0.5 * (degrees + 1.0) * np.log1p(misfit**2 / degrees)
        if below.any():
            if covariance.ndim == 2:
                raise ConfigurationError("a detection limit needs readings whose errors are not correlated")
            density = np.where(below, self._log_chance(np.where(below, ends, 0.0) - predicted, scale), density)
        return np.asarray(self.independence * density.sum(axis=2).T)

    def _log_chance(self, room: Array, scale: Array) -> Array:
        """Return the log probability (S, N, m) that an error of the given scale is below ``room`` (N, m)."""
        from scipy.special import log_ndtr, stdtr

        if self.degrees_of_freedom is None:
            return np.asarray(log_ndtr(room / scale))
        return np.log(np.maximum(stdtr(self.degrees_of_freedom, room / scale), np.finfo(float).tiny))

    def variances(self, predicted: Array, fit: Array, values: Array, covariance: Array) -> Array:
        """Return s^2 (m,) of readings for the sizes that fit best, without correlations.

        predicted    (m,) what one member predicts
        fit          (T S,) its log likelihoods, for each response time and pair of ``sizes``
        values       (m,) the readings
        covariance   (m,) or (m, m) R
        """
        absolute, relative = self.sizes[np.argmax(fit) % len(self.sizes)]
        of_reading = covariance if covariance.ndim == 1 else np.diagonal(covariance)
        known = values if self.detection_limit is None else np.maximum(values, self.detection_limit)
        return np.asarray(of_reading + _of_model(absolute, relative, predicted, known))

    def pull(self, misfit: Array) -> Array:
        """Return the weights (m,) with which least squares fit the readings, of their squared misfits over s^2 (m,).

        A heavy-tailed likelihood gives a large misfit a small weight.
        """
        degrees = self.degrees_of_freedom
        if degrees is None:
            return np.full(misfit.shape, self.independence)
        return self.independence * (degrees + 1.0) / (degrees + misfit)

    def averaged(self, fit: Array) -> Array:
        """Return the log likelihood (N,) of log likelihoods (N, S), averaged over the ``sizes``."""
        return np.asarray(np.logaddexp.reduce(fit, axis=1) - np.log(fit.shape[1]))

    def size_of_error(self, fit: Array, weights: Array) -> Array:
        """Return the sizes (2,) of the model's error, absolute and relative, on average over members.

        fit        (N, T S) log likelihoods, for each response time and pair of ``sizes``
        weights    (N,) of the members, which add up to one
        """
        return np.asarray((weights @ shares_of_cases(fit)) @ np.tile(self.sizes, (len(self.response_time), 1)))


def shares_of_cases(fit: Array) -> Array:
    """Return the probability (N, S) of each column of log likelihoods (N, S), for every member: they add up to one.

    They are zero for a member that is impossible in all columns.
    """
    together = np.logaddexp.reduce(fit, axis=1, keepdims=True)
    return np.asarray(np.exp(fit - np.where(np.isneginf(together), 0.0, together)))


def _of_model(absolute: Array, relative: Array, predicted: Array, values: Array) -> Array:
    """Return a^2 + (r max(|h|, |y|))^2; the arguments are broadcast against each other."""
    return np.asarray(absolute**2 + (relative * np.maximum(np.abs(predicted), np.abs(values))) ** 2)
