"""Prior distributions of single numbers, chosen by name: to draw from, and to evaluate the log density of.

=============  ==============================================  =================================================
name           parameters                                      density
=============  ==============================================  =================================================
``point``      mean                                            all at the mean: the number is known
``normal``     mean, sd                                        Gaussian
``uniform``    low, high                                       the same everywhere between
``lognormal``  mean, sd                                        the logarithm is Gaussian about log(mean) with the
                                                               standard deviation sd: mean is the median
``weibull``    mean, sd; high, if wished                       Weibull with this mean and standard deviation, without
                                                               what is above high
``angle``      mean, sd (radians)                              Gaussian, wrapped to [0, 2 pi)
=============  ==============================================  =================================================

Densities are those of the number itself; they need not be normalised across parameters that are fixed. Every prior of
an angle is wrapped to [0, 2 pi), whatever its name (``AnglePrior``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dafw.core.errors import ConfigurationError
from dafw.core.space import ANGLE, FIELD, NONNEGATIVE, POSITIVE, TWO_PI, Array, Kind

PARAMETERS = {
    "point": ("mean",),
    "normal": ("mean", "sd"),
    "uniform": ("low", "high"),
    "lognormal": ("mean", "sd"),
    "weibull": ("mean", "sd"),
    "angle": ("mean", "sd"),
}
OPTIONAL = {"weibull": ("high",)}
WRAPS = np.arange(-3, 4)
"""Number of turns on each side that are summed for the density of a wrapped normal distribution."""
FAR, RARE = 9.0, 40.0
"""Beyond ``FAR`` standard deviations, or where the chance of a larger number is exp(-``RARE``), nothing is drawn."""
SMALLEST_SHARE = 2.0**-54
"""What is taken for a uniform draw of 0: half of the least other one."""
MOST_TURNS = 10_000
"""Turns over which the density of a prior of an angle may be summed: for a thousand members, 80 MB."""


@dataclass(frozen=True)
class Prior:
    """One distribution; ``parameters`` are named as in the table above. Raises ConfigurationError for other names."""

    name: str
    parameters: Mapping[str, float]

    def __post_init__(self) -> None:
        if self.name not in PARAMETERS:
            raise ConfigurationError(f"there is no prior '{self.name}' (there are: {', '.join(PARAMETERS)})")
        wanted = PARAMETERS[self.name]
        if not set(wanted) <= set(self.parameters) <= {*wanted, *OPTIONAL.get(self.name, ())}:
            raise ConfigurationError(
                f"prior '{self.name}' takes {' and '.join(wanted)}, got {', '.join(self.parameters) or 'nothing'}"
            )
        for key, value in self.parameters.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
                raise ConfigurationError(f"prior '{self.name}': {key} must be a finite number, got {value!r}")
        if self.name == "uniform" and not self["low"] < self["high"]:
            raise ConfigurationError(f"prior 'uniform': low must be below high, got {self['low']} and {self['high']}")
        if "sd" in wanted and not self["sd"] > 0.0:
            raise ConfigurationError(f"prior '{self.name}': sd must be above 0, got {self['sd']}; 'point' has none")
        if self.name == "weibull" and not self.parameters.get("high", 1.0) > 0.0:
            raise ConfigurationError(f"prior 'weibull': high must be above 0, got {self['high']}")
        if self.name in ("lognormal", "weibull") and not self["mean"] > 0.0:
            raise ConfigurationError(f"prior '{self.name}': mean must be above 0, got {self['mean']}")

    @classmethod
    def of(cls, config: Mapping[str, Any], what: str, kind: Kind = FIELD) -> Prior:
        """Make the prior of a number of a ``kind`` from a mapping with its ``name`` and parameters.

        Error messages call it ``what``. Raises ConfigurationError for what is not a prior of such a number: that of
        a positive one draws only numbers above 0, that of a nonnegative one none below.
        """
        options = dict(config)
        of_kind = AnglePrior if kind is ANGLE else cls
        try:
            prior = of_kind(str(options.pop("name", "")), options)
            prior._require_kind(kind)
            return prior
        except ConfigurationError as error:
            raise ConfigurationError(f"{what}: {error}") from error

    def __getitem__(self, key: str) -> float:
        return float(self.parameters[key])

    @property
    def reach(self) -> tuple[float, float]:
        """The least and the largest number that can be expected ever to be drawn."""
        match self.name:
            case "point":
                return self["mean"], self["mean"]
            case "normal":
                return self["mean"] - FAR * self["sd"], self["mean"] + FAR * self["sd"]
            case "uniform":
                return self["low"], self["high"]
            case "lognormal":
                return 0.0, float(self["mean"] * np.exp(FAR * self["sd"]))
            case "weibull":
                shape, scale = self._weibull
                return 0.0, float(min(scale * RARE ** (1.0 / shape), self.parameters.get("high", np.inf)))
            case _:
                return 0.0, TWO_PI

    @property
    def lowest(self) -> float:
        """The lower end of what can be drawn: minus infinity if there is none. Only a point is itself drawn."""
        return -np.inf if self.name == "normal" else self.reach[0]

    def _require_kind(self, kind: Kind) -> None:
        """Raise ConfigurationError if a number can be drawn that variables of a ``kind`` cannot have."""
        allowed = {POSITIVE: "above 0", NONNEGATIVE: "of at least 0"}
        is_zero = kind is POSITIVE and self.name == "point" and self.lowest == 0.0
        if kind in allowed and (self.lowest < 0.0 or is_zero):
            given = ", ".join(f"{key} {value:g}" for key, value in self.parameters.items())
            raise ConfigurationError(
                f"prior '{self.name}' with {given} is not one of a {kind.value} number: it goes down to "
                f"{self.lowest:g}, expected numbers {allowed[kind]}, such as those of 'lognormal' or 'weibull', or of "
                f"'uniform' with low of at least 0"
            )

    @cached_property
    def _weibull(self) -> tuple[float, float]:
        return weibull_parameters(self["mean"], self["sd"])

    @cached_property
    def _share_below(self) -> float:
        """The probability that a Weibull number is at most ``high``; 1 without it."""
        shape, scale = self._weibull
        return float(-np.expm1(-((self.parameters.get("high", np.inf) / scale) ** shape)))

    def draw(self, generator: np.random.Generator) -> float:
        """Return one number."""
        match self.name:
            case "point":
                return self["mean"]
            case "normal":
                return self["mean"] + self["sd"] * float(generator.standard_normal())
            case "uniform":
                return self["low"] + (self["high"] - self["low"]) * _share(generator)
            case "lognormal":
                return self["mean"] * float(np.exp(self["sd"] * generator.standard_normal()))
            case "weibull":
                shape, scale = self._weibull
                if "high" not in self.parameters:
                    return float(scale * generator.weibull(shape))
                return float(scale * (-np.log1p(-self._share_below * _share(generator))) ** (1.0 / shape))
            case _:
                return _reduced(self["mean"] + self["sd"] * float(generator.standard_normal()))

    def log_density(self, x: Array) -> Array:
        """Return the log density at each of ``x`` (...): minus infinity where the density is zero, 0 for a point."""
        x = np.asarray(x, dtype=np.float64)
        match self.name:
            case "point":
                return np.zeros_like(x)
            case "normal":
                return _log_normal(x, self["mean"], self["sd"])
            case "uniform":
                inside = (self["low"] <= x) & (x <= self["high"])
                return np.where(inside, -np.log(self["high"] - self["low"]), -np.inf)
            case "lognormal":
                safe = np.where(x > 0.0, x, 1.0)
                density = _log_normal(np.log(safe), np.log(self["mean"]), self["sd"]) - np.log(safe)
                return np.where(x > 0.0, density, -np.inf)
            case "weibull":
                shape, scale = self._weibull
                safe = np.where(x > 0.0, x, 1.0) / scale
                density = np.log(shape / scale) + (shape - 1.0) * np.log(safe) - safe**shape
                inside = (x > 0.0) & (x <= self.parameters.get("high", np.inf))
                return np.where(inside, density - np.log(self._share_below), -np.inf)
            case _:
                turned = x[..., np.newaxis] + TWO_PI * WRAPS
                return np.asarray(np.logaddexp.reduce(_log_normal(turned, self["mean"], self["sd"]), axis=-1))


@dataclass(frozen=True)
class AnglePrior(Prior):
    """The distribution of an angle: a number is drawn as ever, and what is left of it after whole turns is the angle.

    Raises ConfigurationError for other names, and for a distribution that is wider than ``MOST_TURNS`` turns.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        low, high = self.reach
        if not high - low < MOST_TURNS * TWO_PI:
            raise ConfigurationError(
                f"prior '{self.name}' of an angle goes {(high - low) / TWO_PI:.3g} times around, expected less than "
                f"{MOST_TURNS} times; a uniform one from 0 to {TWO_PI} says that nothing is known"
            )

    @cached_property
    def _turns(self) -> Array:
        """The turns (k,), in radians, that make all that can be drawn out of the angles in [0, 2 pi)."""
        low, high = self.reach
        return np.arange(np.floor(low / TWO_PI), np.floor(high / TWO_PI) + 1.0) * TWO_PI

    def draw(self, generator: np.random.Generator) -> float:
        """Return one angle in [0, 2 pi)."""
        return _reduced(super().draw(generator))

    def log_density(self, x: Array) -> Array:
        """Return the log density at each of the angles ``x`` (...) in radians, which are the same after whole turns."""
        if self.name in ("point", "angle"):  # the one has no density, the other is wrapped by itself
            return super().log_density(x)
        turned = np.mod(np.asarray(x, dtype=np.float64), TWO_PI)[..., np.newaxis] + self._turns
        return np.asarray(np.logaddexp.reduce(super().log_density(turned), axis=-1))


def _share(generator: np.random.Generator) -> float:
    """Return a uniform draw between 0 and 1, but never 0, which a positive number cannot be."""
    return float(generator.random()) or SMALLEST_SHARE


def _reduced(angle: float) -> float:
    """Return an angle less whole turns, in [0, 2 pi)."""
    reduced = float(np.mod(angle, TWO_PI))
    return 0.0 if reduced >= TWO_PI else reduced  # where it is just below zero, the remainder is rounded up


def _log_normal(x: Array, mean: float, sd: float) -> Array:
    return np.asarray(-0.5 * ((x - mean) / sd) ** 2 - np.log(sd * np.sqrt(TWO_PI)))


def weibull_parameters(mean: float, sd: float) -> tuple[float, float]:
    """Return the shape k and the scale lambda of the Weibull distribution with a given mean and standard deviation.

    k solves Gamma(1 + 2/k) / Gamma(1 + 1/k)^2 = 1 + (sd / mean)^2; the left side decreases with k.
    """
    from scipy.optimize import brentq
    from scipy.special import gamma, gammaln

    wanted = np.log1p((sd / mean) ** 2)
    shape = brentq(lambda k: gammaln(1 + 2 / k) - 2 * gammaln(1 + 1 / k) - wanted, 0.05, 1e4, xtol=1e-13, rtol=1e-13)
    return float(shape), float(mean / gamma(1 + 1 / shape))
