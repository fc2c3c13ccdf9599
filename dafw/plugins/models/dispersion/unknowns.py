"""The single numbers of the state: the wind, and whatever else a study estimates, each with its prior.

The wind is always part of the state, with the paper's distributions (Gioia et al. 2024, Sec. III-A,
doi:10.1109/SDF63218.2024.10773899): a Weibull distribution of the speed, a wrapped normal one of the direction. What
is not estimated stays fixed at its value, which may be wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

from dafw.core.errors import ConfigurationError
from dafw.core.priors import Prior
from dafw.core.space import ANGLE, FIELD, NONNEGATIVE, POSITIVE, Kind
from dafw.plugins.models.dispersion.plausible import strongest_wind


@dataclass(frozen=True)
class Unknown:
    """One number of the state, what is believed of it at first, and the largest value that is plausible."""

    name: str
    kind: Kind
    units: str
    prior: Prior
    plausible: float = float("inf")


class Guess(Protocol):
    """What the first guess is made from: the options of a dispersion model."""

    wind_speed: float
    wind_speed_sd: float
    wind_direction: float
    wind_direction_sd: float
    release: list[float]
    release_radius: float
    transport: Any
    estimate: list[str]
    priors: dict[str, Any]
    certain: bool


def _about(name: str, mean: float, sd: float) -> Prior:
    return Prior(name, {"mean": mean, "sd": sd}) if sd > 0.0 else Prior("point", {"mean": mean})


OTHERS: dict[str, tuple[Kind, str, Callable[[Guess], Prior]]] = {
    "diffusion": (POSITIVE, "m2 s-1", lambda guess: _about("lognormal", guess.transport.diffusion, 1.0)),
    "release_x": (FIELD, "m", lambda guess: _about("normal", guess.release[0], guess.release_radius)),
    "release_y": (FIELD, "m", lambda guess: _about("normal", guess.release[1], guess.release_radius)),
    "amount": (POSITIVE, "1", lambda guess: _about("lognormal", 1.0, 0.5)),
}
"""What can be estimated besides the wind: its kind, its units, and its prior where a study gives none."""


def unknowns(guess: Guess) -> list[Unknown]:
    """Return the numbers of the state in their order; raises ConfigurationError for names and priors there are not."""
    mean, sd = guess.wind_speed, guess.wind_speed_sd
    if sd > 0.0 and not 1e-3 * mean <= sd <= 1e3 * mean:
        raise ConfigurationError(
            f"wind_speed_sd must be 0 or between a thousandth of wind_speed and a thousand times it (a Weibull "
            f"distribution has that mean), got {sd:g} with a mean of {mean:g} m/s"
        )
    names = ["wind_speed", "wind_direction", *guess.estimate]
    if wrong := [name for name in guess.estimate if name not in OTHERS]:
        raise ConfigurationError(f"estimate: '{wrong[0]}' cannot be estimated (accepted: {', '.join(OTHERS)})")
    if len(set(names)) < len(names):
        raise ConfigurationError(f"estimate: a name stands twice in {guess.estimate}")
    if wrong := [name for name in guess.priors if name not in names]:
        raise ConfigurationError(f"priors: '{wrong[0]}' is not estimated (estimated: {', '.join(names)})")
    if "diffusion" in names and guess.transport.scheme == "supg":
        raise ConfigurationError("estimate: the scheme 'supg' is made for one diffusion; choose another scheme")
    found = [
        Unknown("wind_speed", NONNEGATIVE, "m s-1", _about("weibull", mean, sd), strongest_wind(mean, sd)),
        Unknown("wind_direction", ANGLE, "rad", _about("angle", guess.wind_direction, guess.wind_direction_sd)),
        *(Unknown(name, kind, units, prior(guess)) for name, (kind, units, prior) in OTHERS.items() if name in names),
    ]
    if guess.certain:
        return [replace(one, prior=_about("point", one.prior["mean"], 0.0)) for one in found]
    priors = {name: Prior.of(prior, f"priors: {name}") for name, prior in guess.priors.items()}
    return [replace(one, prior=priors.get(one.name, one.prior)) for one in found]
