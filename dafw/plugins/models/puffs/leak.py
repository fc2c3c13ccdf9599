"""What all models of puffs share: the unknown numbers of a steady leak, the measured wind, the gas.

The widths of a puff grow as those of an age shorter than the time scale of the turbulence, in proportion to the age
(Taylor 1921, doi:10.1112/plms/s2-20.1.196)::

    s^2 = s_0^2 + (spread sigma_u a)^2,    h^2 = h_0^2 + (lift sigma_w a)^2

with the standard deviations sigma of the measured wind over the last ten minutes. ``lift`` is 1 by that theory; at 2
m/s, h = 0.3 a lies between Briggs' classes A and B of a sunny day (1973; h = 0.20 and 0.12 times the distance).
``spread`` is less than 1: it is the share of the sideways fluctuations that puff and anemometer do not have in common.

This module is imported with the models' options, so it must be light.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Model
from dafw.core.options import REQUIRED, option
from dafw.core.priors import Prior
from dafw.core.rng import MemberStreams
from dafw.core.sharing import Shared
from dafw.core.space import FIELD, POSITIVE, Array, Kind, Variable
from dafw.plugins.models.wind_record import WindFile

if TYPE_CHECKING:
    from dafw.plugins.models.wind_record import WindRecord

UNKNOWN: Mapping[str, tuple[Kind, str]] = {
    "release_x": (FIELD, "m"),
    "release_y": (FIELD, "m"),
    "rate": (POSITIVE, "g s-1"),
    "wind_turn": (FIELD, "rad"),
    "wind_factor": (POSITIVE, "1"),
    "first_width": (POSITIVE, "m"),
    "first_height": (POSITIVE, "m"),
    "spread": (POSITIVE, "1"),
    "lift": (POSITIVE, "1"),
}
"""Kind and units of the unknown numbers, in the order of the state."""
PRIORS: Mapping[str, Mapping[str, Any]] = {
    "rate": {"name": "uniform", "low": 0.0, "high": 5.0},
    "wind_turn": {"name": "normal", "mean": 0.0, "sd": 0.1},
    "wind_factor": {"name": "lognormal", "mean": 1.0, "sd": 0.15},
    "first_width": {"name": "lognormal", "mean": 0.6, "sd": 0.5},
    "first_height": {"name": "lognormal", "mean": 0.6, "sd": 0.5},
    "spread": {"name": "lognormal", "mean": 0.3, "sd": 0.5},
    "lift": {"name": "lognormal", "mean": 1.0, "sd": 0.3},
}
GAS_CONSTANT = 8.314462618
"""J mol^-1 K^-1."""
SHORTEST, LENGTHENING = 0.25, 0.06
"""Interval of ages of a fresh puff in s, and by how much intervals grow in a second of age."""


@dataclass
class Air:
    """The air and the gas, which say how many ppm a gram in a cubic metre is."""

    molar_mass: float = option(16.043, "of the gas, g/mol; methane", above=0.0)
    temperature: float = option(286.0, "K", above=0.0)
    pressure: float = option(1.0e5, "Pa", above=0.0)

    @property
    def ppm_per_gram(self) -> float:
        """The mole fraction in ppm of one gram in a cubic metre."""
        return 1e6 * GAS_CONSTANT * self.temperature / (self.pressure * self.molar_mass)


@dataclass
class Leak(Model):
    """A leak of unknown place and rate in a measured wind.

    The state begins with ``readings`` entries, numbers that sensors read; the unknown numbers follow.
    """

    unknown: ClassVar[Mapping[str, tuple[Kind, str]]] = UNKNOWN
    usual: ClassVar[Mapping[str, Mapping[str, Any]]] = PRIORS

    area: list[float] = option(REQUIRED, "where the leak may be: [x_min, y_min, x_max, y_max] in metres")
    wind: WindFile = option(WindFile, "the measured wind")
    dt: float = option(60.0, "length of a step, s", above=0.0)
    moments: int = option(6, "moments in a step over which means are averaged", minimum=1)
    oldest: float = option(180.0, "age of the oldest puff that counts, s", above=0.0)
    mixing_height: float = option(50.0, "the largest height of a puff, m", above=0.0)
    air: Air = option(Air, "what turns grams in a cubic metre into ppm")
    priors: dict[str, Any] = option({}, "first guesses that differ from the usual ones, by name of the number")
    truth: dict[str, float] = option({}, "numbers of the state that are known exactly, by name; for a twin")

    _shared: Shared = field(default_factory=Shared, init=False, repr=False, compare=False)
    _kept: dict[float, tuple[Array, Array]] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def named(self) -> str:
        """The model's name in errors about its options."""
        return "model 'puffs'"

    def __post_init__(self) -> None:
        if len(self.area) != 4 or not (self.area[0] < self.area[2] and self.area[1] < self.area[3]):
            raise ConfigurationError(
                f"{self.named}: area must be [x_min, y_min, x_max, y_max] in metres, got {self.area}"
            )
        for group in (self.priors, self.truth):
            if wrong := [name for name in group if name not in self.unknown]:
                raise ConfigurationError(
                    f"{self.named}: there is no number '{wrong[0]}' (there are: {', '.join(self.unknown)})"
                )
        low_x, low_y, high_x, high_y = self.area
        usual = {
            "release_x": {"name": "uniform", "low": low_x, "high": high_x},
            "release_y": {"name": "uniform", "low": low_y, "high": high_y},
            **self.usual,
        }
        known = {name: {"name": "point", "mean": float(value)} for name, value in self.truth.items()}
        chosen = usual | dict(self.priors) | known
        self._priors = {
            name: Prior.of(chosen[name], f"{self.named}: {'truth' if name in known else 'priors'}: {name}", kind)
            for name, (kind, _) in self.unknown.items()
        }

    def unknown_variables(self) -> list[Variable]:
        """Return the unknown numbers as variables of the state."""
        return [Variable(name, 1, kind, units) for name, (kind, units) in self.unknown.items()]

    def release_mark(self) -> dict[str, tuple[float, float]]:
        """Return the landmark of the leak, where its place is known exactly."""
        if {"release_x", "release_y"} <= set(self.truth):
            return {"release": (self.truth["release_x"], self.truth["release_y"])}
        return {}

    def share_with(self, shared: Shared) -> None:
        """Read the wind once for all models of a run."""
        self._shared = shared

    @property
    def input_files(self) -> Sequence[Path]:
        """The files with the wind."""
        from dafw.plugins.readings.files.any_file import paths_of

        return paths_of(self.wind)

    @cached_property
    def record(self) -> WindRecord:
        """The measured wind; raises ReadingsError, and ConfigurationError for options that do not fit together."""
        from dafw.plugins.models.wind_record import read_wind

        try:
            return self._shared.once(("wind record", repr(self.wind)), lambda: read_wind(self.wind))
        except ConfigurationError as error:
            raise ConfigurationError(f"{self.label}: {error}") from error

    def require_available(self) -> None:
        """Read the wind; raises ReadingsError if it cannot be read."""
        _ = self.record  # reading it is all that is wanted

    def notes(self) -> list[str]:
        """Return what the wind record holds, in one sentence."""
        record = self.record
        if self.wind.steady:
            return []
        measured = record.time[1:-1]
        gap = float(np.diff(measured).max())
        said = [
            f"{self.label}: {len(measured)} samples of the wind of t = {measured[0]:g} to "
            f"{measured[-1]:g} s, the longest gap {gap:g} s, {record.spikes} spikes left out"
        ]
        if self.wind.direction is not None:
            said.append(f"{self.label}: directions are taken as those {self.wind.blows} which the wind blows")
        if self.wind.upward is not None:
            said.append(
                f"{self.label}: upward fluctuations of the wind are {self.wind.upward:g} of sideways ones, assumed"
            )
        return said

    def initial(self, n_members: int, rng: MemberStreams) -> Array:
        """Return draws (N, n) from the priors; no sensor has met any gas."""
        streams = (rng[member] for member in range(n_members))
        drawn = [[prior.draw(stream) for prior in self._priors.values()] for stream in streams]
        numbers = np.array(drawn).reshape(n_members, len(self.unknown))
        return np.hstack([np.zeros((n_members, self.space.size - len(self.unknown))), numbers])

    def log_first_guess(self, members: Array) -> Array:
        """Return the log density (N,) of the priors."""
        numbers = members[:, -len(self.unknown) :]
        parts = [prior.log_density(numbers[:, column]) for column, prior in enumerate(self._priors.values())]
        return np.sum(parts, axis=0)

    def _numbers(self, members: Array) -> tuple[Array, Array, Array, list[Array]]:
        """Return the unknown numbers of members (N, n): places (N, 2), rates (N,), six of a puff (N, 6), any others."""
        x, y, rate, *others = members[:, -len(self.unknown) :].T
        return np.stack([x, y], axis=1), rate, np.stack(others[:6], axis=1), others[6:]

    @cached_property
    def _ages(self) -> tuple[Array, Array]:
        from dafw.plugins.models.puffs.path_means import ages_to

        return ages_to(self.oldest, SHORTEST, LENGTHENING)

    def _moments(self, t: float) -> Array:
        """Return the moments (k,) in the step from t that means are made of."""
        return np.asarray(t + (np.arange(self.moments) + 0.5) / self.moments * self.dt)

    def _step_inputs(self, t: float) -> tuple[Array, Array]:
        """Return how far puffs were carried (k, a, 2) in m, and the turbulence (k, 2) in m/s, in the step from t."""
        moments = self._moments(t)
        born = moments[:, np.newaxis] - self._ages[0]
        carried = self.record.carried_by(moments)[:, np.newaxis] - self.record.carried_by(born)
        return carried, self.record.turbulence_at(moments)

    def _inputs(self, t: float) -> tuple[Array, Array]:
        """Return ``_step_inputs``, kept, because every re-run asks for those of all steps."""
        if t not in self._kept:
            self._kept[t] = self._step_inputs(t)
        return self._kept[t]
