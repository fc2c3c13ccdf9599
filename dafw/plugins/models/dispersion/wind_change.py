"""A wind whose speed and direction change in time: smoothly at random, as prescribed, or as an anemometer measured.

The state's ``wind_speed`` I and ``wind_direction`` d are the wind at t = 0. At the time t the wind has

    speed  I exp(s(t)),   direction  d + a(t),   s(0) = a(0) = 0

==============  =======================================================================================================
``none``        s = a = 0
``smooth``      natural cubic splines through s_i and a_i at the times i * spacing, i = 1 ... knots, held after the last
                one. These numbers are variables of the state, ``wind_speed_change_i`` and ``wind_direction_change_i``
``prescribed``  a(t) = veer min(t / duration, 1),   exp(s(t)) = 1 + gust sin(2 pi t / period)
``measured``    those of an anemometer's wind u, a mean over ``average`` seconds: exp(s(t)) = |u(t)| / |u(0)|, and a(t)
                is the angle from u(0) to u(t). I and d are its wind at t = 0 and what the site's differs by
==============  =======================================================================================================

In the step from t to t + dt the wind is that of t + dt/2, so that the gas travels as far as in a wind that changes
within the step, up to the second order of dt. The wind of ``ad_ins`` is quasi-steady: at each time it is the steady
wind of the present speed and direction. With ``every`` the wind is that of the middle of an interval of this length,
and held in all steps whose middle lies in it.

This module is imported with the options of the models, so it must be light.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from dafw.core.errors import ConfigurationError
from dafw.core.options import option
from dafw.core.space import TWO_PI, Array
from dafw.plugins.models.wind_record import WindColumns

if TYPE_CHECKING:
    from dafw.plugins.models.wind_record import WindRecord

CALM = 0.5
"""Speed at t = 0, in m/s, below which the later wind is not told relative to it."""


@dataclass
class WindChangeOptions:
    """Options of the wind's change in time."""

    kind: str = option(
        "none",
        "none; smooth: a random function of time, part of the state; prescribed: a veer and gusts, for truths; "
        "measured: that of an anemometer",
        choices=("none", "smooth", "prescribed", "measured"),
    )
    every: float | None = option(
        None, "seconds for which a wind is held before it changes again, to save time; null: each step", above=0.0
    )
    knots: int = option(4, "smooth: number of times at which the change is a number of the state", minimum=1)
    spacing: float = option(25.0, "smooth: seconds between them; the first is so long after t = 0", above=0.0)
    speed_sd: float = option(
        0.1, "smooth: standard deviation of the speed's change, relative; 0: the speed stays", minimum=0.0
    )
    direction_sd: float = option(
        np.pi / 18.0,
        "smooth: standard deviation of the direction's change, radians; 0: the direction stays",
        minimum=0.0,
    )
    veer: float = option(0.0, "prescribed: change of direction in all, radians, counter-clockwise if positive")
    duration: float = option(100.0, "prescribed: seconds that the veer takes, from t = 0 on", above=0.0)
    gust: float = option(
        0.0, "prescribed: amplitude of the speed's oscillation, relative to the speed", minimum=0.0, maximum=1.0
    )
    period: float = option(30.0, "prescribed: period of that oscillation in seconds", above=0.0)
    measured: WindColumns = option(WindColumns, "measured: the file of the wind")
    average: float = option(
        10.0,
        "measured: seconds over which that wind is averaged, so that no gust of a moment is the site's; after t = 0 "
        "'every' if that is longer",
        above=0.0,
    )

    def __post_init__(self) -> None:
        if self.kind != "prescribed" and (self.veer != 0.0 or self.gust != 0.0):
            name = "veer" if self.veer != 0.0 else "gust"
            raise ConfigurationError(
                f"'{name}' belongs to kind 'prescribed', and the kind is '{self.kind}'; choose kind=prescribed, or "
                f"{name}=0"
            )
        if self.kind == "smooth" and self.speed_sd == 0.0 and self.direction_sd == 0.0:
            raise ConfigurationError("speed_sd and direction_sd are both 0, so nothing changes: choose kind=none")
        if (self.kind == "measured") != bool(self.measured.file):
            raise ConfigurationError(
                f"measured.file and kind=measured belong together, got kind={self.kind} and the file "
                f"'{self.measured.file}'"
            )


class WindChange:
    """The change of the wind in time that the options describe.

    Attributes:
        changes: whether the wind changes at all.
        speed_names: variables of the state that hold s_i; none unless the change is smooth.
        direction_names: those that hold a_i, in radians.
    """

    def __init__(self, options: WindChangeOptions) -> None:
        self.options = options
        self.changes = options.kind != "none"
        smooth = options.kind == "smooth"
        numbers = range(1, options.knots + 1)
        self.speed_names = [f"wind_speed_change_{i}" for i in numbers if smooth and options.speed_sd > 0.0]
        self.direction_names = [f"wind_direction_change_{i}" for i in numbers if smooth and options.direction_sd > 0.0]

    @cached_property
    def record(self) -> WindRecord:
        """The measured wind; raises ReadingsError, and ConfigurationError for options that do not fit together."""
        from dafw.plugins.models.wind_record import read_wind_along_the_ground

        return read_wind_along_the_ground(self.options.measured, "wind_change.measured")

    @cached_property
    def at_start(self) -> tuple[float, float]:
        """The measured wind at t = 0: speed in m/s, and the direction towards which it blows, radians from east.

        Raises ConfigurationError for a calm, besides the errors of ``record``.
        """
        first, last = self.record.time[[1, -2]]
        if not first - self.options.average <= 0.0 <= last + self.options.average:
            raise ConfigurationError(
                f"wind_change.measured: its times, from {first:g} to {last:g} s, do not reach t = 0; set measured.start"
            )
        u, v = self._mean(0.0, self.options.average)
        if np.hypot(u, v) < CALM:
            raise ConfigurationError(
                f"wind_change.measured: the later wind is told relative to that at t = 0, which must be {CALM:g} m/s "
                f"or more, got {np.hypot(u, v):.2g} m/s; begin at another time (start), or average for longer"
            )
        return float(np.hypot(u, v)), float(np.arctan2(v, u) % TWO_PI)

    def _mean(self, t: float, length: float) -> Array:
        """Return the components (2,) of the measured wind in m/s, averaged over ``length`` seconds about t (s)."""
        begin, end = self.record.carried_by(np.array([t - 0.5 * length, t + 0.5 * length]))
        return np.asarray((end - begin) / length)

    def notes(self) -> list[str]:
        """Return what the record of a measured wind holds, in one sentence."""
        if self.options.kind != "measured":
            return []
        record, (speed, direction) = self.record, self.at_start
        measured = record.time[1:-1]
        return [
            f"measured wind: {len(measured)} times from {measured[0]:g} to {measured[-1]:g} s, {record.spikes} spikes "
            f"left out; at t = 0 {speed:.2f} m/s towards {direction:.2f} radians"
        ]

    @cached_property
    def _spline(self) -> Any:
        """The spline of every number being 1 and the others 0; the first is the value at t = 0."""
        from scipy.interpolate import CubicSpline

        knots = self.options.knots
        return CubicSpline(self.options.spacing * np.arange(knots + 1), np.eye(knots + 1), bc_type="natural")

    def weights(self, t: float) -> Array:
        """Return the weights (knots,) of the numbers of a smooth change at the time t (s)."""
        last = self.options.spacing * self.options.knots
        return np.asarray(self._spline(min(t, last))[1:])

    def wind(self, t: float, speed: Array, direction: Array, state: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return speed (N,) in m/s and direction (N,) in radians at the time t (s).

        Args:
            t: time in s.
            speed: (N,) at t = 0, in m/s.
            direction: (N,) at t = 0, in radians.
            state: the members' variables, each (N, size), by name.
        """
        options = self.options
        if options.kind == "none":
            return speed, direction
        if options.every is not None:
            t = (np.floor(t / options.every) + 0.5) * options.every
        if options.kind == "prescribed":
            speed = speed * (1.0 + options.gust * np.sin(TWO_PI * t / options.period))
            return speed, np.mod(direction + options.veer * min(t / options.duration, 1.0), TWO_PI)
        if options.kind == "measured":
            length = max(options.average, options.every or 0.0)
            (u, v), (first, towards) = self._mean(t, length), self.at_start
            return speed * (np.hypot(u, v) / first), np.mod(direction + np.arctan2(v, u) - towards, TWO_PI)
        weights = self.weights(t)
        if self.speed_names:
            speed = speed * np.exp(self._change(self.speed_names, weights, state))
        if self.direction_names:
            direction = np.mod(direction + self._change(self.direction_names, weights, state), TWO_PI)
        return speed, direction

    def _change(self, names: list[str], weights: Array, state: Mapping[str, Array]) -> Array:
        # Summed one by one: a matrix product may round differently for another number of members.
        total = np.zeros(len(state[names[0]]))
        for name, weight in zip(names, weights, strict=True):
            total += weight * state[name][:, 0]
        return total
