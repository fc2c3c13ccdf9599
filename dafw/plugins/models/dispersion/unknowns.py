"""The single numbers of the state: the wind, and whatever else a study estimates, each with its prior.

The wind is always part of the state, with the paper's distributions (Gioia et al. 2024, Sec. III-A,
doi:10.1109/SDF63218.2024.10773899): a Weibull distribution of the speed, a wrapped normal one of the direction. What
is not estimated stays fixed at its value, which may be wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from dafw.core.errors import ConfigurationError
from dafw.core.priors import Prior
from dafw.core.space import ANGLE, FIELD, NONNEGATIVE, POSITIVE, Kind
from dafw.plugins.models.dispersion.plausible import strongest_wind
from dafw.plugins.models.dispersion.sources import SourceOptions, sources
from dafw.plugins.models.dispersion.wind_change import WindChange, WindChangeOptions


@dataclass(frozen=True)
class Unknown:
    """One number of the state: its ``value`` in the options, what is believed of it at first, what is plausible."""

    name: str
    kind: Kind
    units: str
    value: float
    prior: Prior
    plausible: float = float("inf")


@dataclass(frozen=True)
class Possible:
    """What can be estimated: its kind, units, value in the options, and what makes its default prior from that."""

    kind: Kind
    units: str
    value: float
    prior: Callable[[float], Prior]


class Guess(Protocol):
    """What the first guess is made from: the options of a dispersion model."""

    wind_speed_sd: float
    wind_speed_max: float | None
    wind_direction_sd: float
    wind_change: WindChangeOptions
    release: list[float]
    release_radius: float
    release_sd: float | None
    source: SourceOptions
    transport: Any
    estimate: list[str]
    priors: dict[str, Any]
    certain: bool


def about(name: str, mean: float, sd: float) -> Prior:
    """Return the prior ``name`` with a mean and a standard deviation; with an sd of 0 the number is known."""
    return Prior(name, {"mean": mean, "sd": sd}) if sd > 0.0 else Prior("point", {"mean": mean})


def _others(guess: Guess) -> dict[str, Possible]:
    """Return what can be estimated of every model besides the wind, in the order of the state."""
    off = guess.release_radius if guess.release_sd is None else guess.release_sd
    usual: dict[str, tuple[Kind, str, Callable[[float], Prior]]] = {
        "release_x": (FIELD, "m", lambda x: about("normal", x, off)),
        "release_y": (FIELD, "m", lambda y: about("normal", y, off)),
        "amount": (POSITIVE, "1", lambda amount: about("lognormal", amount, 0.5)),
        "rate": (POSITIVE, "s-1", lambda rate: about("lognormal", rate, 1.0)),
        "leak_start": (FIELD, "s", lambda start: Prior("uniform", {"low": 0.0, "high": max(60.0, 2.0 * start)})),
    }
    diffusion = guess.transport.diffusion
    listed = {"diffusion": Possible(POSITIVE, "m2 s-1", diffusion, lambda value: about("lognormal", value, 1.0))}
    for source in sources(guess.release, guess.release_radius, guess.source):
        for quantity, name in source.names.items():
            kind, units, prior = usual[quantity]
            listed[name] = Possible(kind, units, source.values[quantity], prior)
    return listed


def _require_known(guess: Guess, accepted: Sequence[str]) -> None:
    """Raise ConfigurationError if ``estimate`` has a name that is not accepted, or one twice."""
    for name in guess.estimate:
        if name not in accepted:
            of_a = {"rate": "leak", "leak_start": "leak", "amount": "burst"}.get(name)
            hint = f"; it belongs to a {of_a}: source.kind={of_a}" if of_a else ""
            raise ConfigurationError(f"estimate: '{name}' cannot be estimated (accepted: {', '.join(accepted)}){hint}")
    if len(set(guess.estimate)) < len(guess.estimate):
        raise ConfigurationError(f"estimate: a name stands twice in {guess.estimate}")


def unknowns(guess: Guess, own: Mapping[str, Possible], wind: tuple[float, float]) -> list[Unknown]:
    """Return the numbers of the state in their order.

    Args:
        guess: the options of the model.
        own: what only this model can estimate.
        wind: mean of the first guess of the wind at t = 0, speed in m/s and direction in radians.

    Raises ConfigurationError for names and priors there are not, and for priors of other kinds of numbers.
    """
    (mean, direction), sd = wind, guess.wind_speed_sd
    if sd > 0.0 and not 1e-3 * mean <= sd <= 1e3 * mean:
        raise ConfigurationError(
            f"wind_speed_sd must be 0 or between a thousandth of wind_speed and a thousand times it (a Weibull "
            f"distribution has that mean), got {sd:g} with a mean of {mean:g} m/s"
        )
    others = {**_others(guess), **own}
    _require_known(guess, list(others))
    if "diffusion" in guess.estimate and guess.transport.scheme == "supg":
        raise ConfigurationError("estimate: the scheme 'supg' is made for one diffusion; choose another scheme")
    change = WindChange(guess.wind_change)
    speed, most = about("weibull", mean, sd), guess.wind_speed_max
    if most is not None:
        if most <= mean:
            raise ConfigurationError(f"wind_speed_max must be above wind_speed, {mean:g} m/s, got {most:g}")
        if sd > 0.0:
            speed = Prior("weibull", {"mean": mean, "sd": sd, "high": most})
    found = [
        Unknown("wind_speed", NONNEGATIVE, "m s-1", mean, speed, strongest_wind(mean, sd)),
        Unknown("wind_direction", ANGLE, "rad", direction, about("angle", direction, guess.wind_direction_sd)),
    ]
    for name, one in others.items():
        if name in guess.estimate:
            found.append(Unknown(name, one.kind, one.units, one.value, one.prior(one.value)))
    for names, units, spread in (
        (change.speed_names, "1", guess.wind_change.speed_sd),
        (change.direction_names, "rad", guess.wind_change.direction_sd),
    ):
        found += [Unknown(name, FIELD, units, 0.0, about("normal", 0.0, spread)) for name in names]
    names = [one.name for one in found]
    if wrong := [name for name in guess.priors if name not in names]:
        raise ConfigurationError(f"priors: '{wrong[0]}' is not estimated (estimated: {', '.join(names)})")
    if guess.certain:
        return [replace(one, prior=about("point", one.value, 0.0)) for one in found]
    kinds = {one.name: one.kind for one in found}
    priors = {name: Prior.of(prior, f"priors: {name}", kinds[name]) for name, prior in guess.priors.items()}
    return [replace(one, prior=priors.get(one.name, one.prior)) for one in found]
