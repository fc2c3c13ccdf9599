"""Where the gas comes from: bursts, which are there at t = 0, and leaks, which release gas in the course of time.

Both have the shape of a bell, b(x) = exp(-|x - place|^2 / (2 radius^2)), whose maximum is 1:

    burst   c(0) = amount b                         the concentration that it leaves at the start
    leak    f(t) = rate b   from start to end       the source in dc/dt + w . grad c - epsilon lap c = f

Concentrations are relative to the maximum of a burst with the amount 1. So ``rate``, in 1/s, is what a leak would add
to the maximum in a second if nothing were carried away. In a second a leak releases as much gas as a burst with
``amount = rate``: 0.05 for 20 s make the gas of one burst, 2 pi radius^2 where the whole bell lies on the mesh.

A step of the transport is given the mean of f over the step. So a step in which a leak begins or ends counts by the
fraction of it in which gas comes out, and the released gas is exact for any start.

The part of a bell that lies inside a building or outside the site releases nothing. A place far outside, which a filter
may propose, is a source without gas.

This module is imported with the options of the models, so it must be light.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dafw.core.errors import ConfigurationError
from dafw.core.options import REQUIRED, build, option
from dafw.core.space import Array

LONGEST = 3600.0
"""Seconds of a leak in still air, of whose concentration a belief may be before it counts as diverged."""


@dataclass(kw_only=True)
class OneSource:
    """What the first source and further ones have in common."""

    kind: str = option(
        "burst", "burst: all gas is there at t = 0; leak: it comes out in time", choices=("burst", "leak")
    )
    amount: float | None = option(None, "of a burst: the maximum of its bell; null: 1", above=0.0)
    rate: float | None = option(
        None, "of a leak: what its bell's maximum would gain in a second, 1/s; must be given", above=0.0
    )
    start: float = option(0.0, "of a leak: time at which it begins, s", minimum=0.0)
    end: float | None = option(None, "of a leak: time at which it ends, s; null: never", above=0.0)

    def __post_init__(self) -> None:
        if self.kind == "burst":
            given = {"rate": self.rate, "end": self.end, "start": self.start or None}
            if wrong := [name for name, value in given.items() if value is not None]:
                raise ConfigurationError(
                    f"'{wrong[0]}' belongs to a leak, and the kind is 'burst', whose gas is there at t = 0; choose "
                    f"kind=leak, or {wrong[0]}={'0' if wrong[0] == 'start' else 'null'}"
                )
            return
        if self.amount is not None:
            raise ConfigurationError("'amount' belongs to a burst; a leak has a rate: set amount=null")
        if self.rate is None:
            raise ConfigurationError("a leak must be given its rate, in 1/s: 0.05 make the gas of a burst in 20 s")
        if self.end is not None and not self.end > self.start:
            raise ConfigurationError(f"a leak must end after its start, got start={self.start:g} and end={self.end:g}")


@dataclass(kw_only=True)
class FurtherSource(OneSource):
    """One of ``SourceOptions.more``."""

    release: list[float] = option(REQUIRED, "place, [x, y] in metres")
    release_radius: float | None = option(
        None, "standard deviation of its bell in metres; null: the first's", above=0.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.release) != 2:
            raise ConfigurationError(f"the release must be one place [x, y] in metres, got {self.release}")


@dataclass(kw_only=True)
class SourceOptions(OneSource):
    """Options of the sources. The first one's place and radius are ``release`` and ``release_radius`` of the model."""

    more: list[dict[str, Any]] = option(
        [], "further sources: mappings with release ([x, y], m), kind, amount or rate, start, end, release_radius"
    )


@dataclass(frozen=True)
class Source:
    """One source; ``values`` are its quantities by name (m, 1/s, s), of which a state may have others.

    >>> Source(2, "leak", {"release_x": 0.0, "release_y": 9.0, "rate": 0.1, "leak_start": 0.0}, 30.0).names["rate"]
    'rate_2'
    """

    number: int
    kind: str
    values: Mapping[str, float]
    radius: float
    end: float = np.inf

    @property
    def place(self) -> tuple[float, float]:
        """Where the options say that it is, in m."""
        return self.values["release_x"], self.values["release_y"]

    @property
    def names(self) -> dict[str, str]:
        """What its quantities are called in a state: those of the second source ``release_2_x``, ``rate_2``, ..."""
        if self.number == 1:
            return {quantity: quantity for quantity in self.values}
        places = {f"release_{axis}": f"release_{self.number}_{axis}" for axis in "xy"}
        return {quantity: places.get(quantity, f"{quantity}_{self.number}") for quantity in self.values}

    def value(self, quantity: str, state: Mapping[str, Array]) -> Array | float:
        """Return a quantity: (N, 1) where the state of N members has it, otherwise the number of the options."""
        return state.get(self.names[quantity], self.values[quantity])

    def bell(self, nodes: Array, state: Mapping[str, Array]) -> Array:
        """Return the bell of height 1 at nodes (nodes, 2): (N, nodes), or (nodes,) if no member has its own place."""
        x, y = self.value("release_x", state), self.value("release_y", state)
        off = (nodes[:, 0] - x) ** 2 + (nodes[:, 1] - y) ** 2
        return np.asarray(np.exp(-off / (2.0 * self.radius**2)))

    def seconds(self, t: float, dt: float, state: Mapping[str, Array]) -> Array | float:
        """Return for how long gas comes out of a leak in the step from t to t + dt, in s: (N, 1), or one number."""
        begins = np.maximum(self.value("leak_start", state), t)
        return np.maximum(np.minimum(self.end, t + dt) - begins, 0.0)


def sources(release: Sequence[float], radius: float, options: SourceOptions) -> list[Source]:
    """Return all sources, numbered from 1; raises ConfigurationError where one of ``more`` is wrong.

    Args:
        release: place of the first, [x, y] in m.
        radius: standard deviation of its bell in m, and of others that give none.
        options: those of the first, with ``more``.
    """
    found = [_source(1, options, release, radius)]
    for number, entry in enumerate(options.more, 2):
        further = build(FurtherSource, entry, f"source.more, source {number}")
        found.append(_source(number, further, further.release, further.release_radius or radius))
    return found


def _source(number: int, options: OneSource, release: Sequence[float], radius: float) -> Source:
    given = asdict(options)
    values = {"release_x": float(release[0]), "release_y": float(release[1])}
    if options.kind == "burst":
        return Source(number, "burst", {**values, "amount": given["amount"] or 1.0}, radius)
    end = np.inf if options.end is None else options.end
    return Source(number, "leak", {**values, "rate": given["rate"], "leak_start": options.start}, radius, end)


def released(of: Sequence[Source], nodes: Array, state: Mapping[str, Array]) -> Array:
    """Return the gas that the bursts leave at t = 0: (N, nodes), or (nodes,) if it is the same in all members."""
    bells = (source.value("amount", state) * source.bell(nodes, state) for source in of if source.kind == "burst")
    return _total(bells, np.zeros(len(nodes)))


def supply(of: Sequence[Source], nodes: Array, state: Mapping[str, Array], t: float, dt: float) -> Array | None:
    """Return what the leaks add in the step from t to t + dt, in concentration per second, averaged over the step.

    It is (N, nodes), or (nodes,) if it is the same in all members, or None if no gas comes out.
    """
    leaks = ((source, source.seconds(t, dt, state)) for source in of if source.kind == "leak")
    added = [
        (source.value("rate", state) * (seconds / dt)) * source.bell(nodes, state)
        for source, seconds in leaks
        if np.any(seconds > 0.0)
    ]
    return _total(iter(added[1:]), added[0]) if added else None


def _total(parts: Iterator[Array], first: Array) -> Array:
    for part in parts:
        first = first + part
    return first


def largest_scale(of: Sequence[Source], estimated: Sequence[str]) -> float:
    """Return by how much the sources may exceed a burst with the amount 1, as a bound for beliefs that diverged.

    An unknown amount or rate may be many times the one that the options state.
    """
    total = 0.0
    for source in of:
        quantity, seconds = ("amount", 1.0) if source.kind == "burst" else ("rate", LONGEST)
        unknown = 100.0 if source.names[quantity] in estimated else 1.0
        total += unknown * seconds * source.values[quantity]
    return max(1.0, total)
