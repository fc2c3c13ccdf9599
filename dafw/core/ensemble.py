"""Frozen value types that travel through a cycle: ``Ensemble``, ``Vehicle``, ``Route``, ``Step``, ``Analysis``.

Arrays inside them are read-only; whoever wants others makes new ones. What a plugin must remember from one call to
the next is a ``Memory``: named arrays that it hands out and takes back, never something hidden on ``self``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from dafw.core.domain import Domain
from dafw.core.space import Array, StateSpace

type Memory = Mapping[str, Any]


def freeze(array: Any) -> Array:
    """Return ``array`` as float64 that cannot be written to, in C order: the order decides the bits of sums."""
    frozen = np.asarray(array, dtype=np.float64, order="C")
    frozen.setflags(write=False)
    return frozen


@dataclass(frozen=True, eq=False)
class Diagnostic:
    """Numbers that a plugin reports about one cycle, recorded in ``run.nc`` under the plugin's kind and their name.

    ``dims`` name the axes of ``values``; ``member`` and ``vehicle`` are the run's own.
    """

    values: Any
    dims: tuple[str, ...] = ()
    units: str = "1"
    long_name: str = ""


type Diagnostics = Mapping[str, Diagnostic]


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Members (N, n) of a state space at a time in seconds.

    >>> belief = Ensemble([[1.0, 0.1], [3.0, 6.2]], StateSpace([Variable("x", 1), Variable("angle", 1, ANGLE)]))
    >>> belief.mean.round(3), belief.spread.round(3)
    (array([2.   , 0.008]), array([1.414, 0.13 ]))
    """

    members: Array
    space: StateSpace
    time: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "members", freeze(self.members))

    def __len__(self) -> int:
        return len(self.members)

    @cached_property
    def mean(self) -> Array:
        """The mean (n,); circular for angles."""
        return freeze(self.space.mean(self.members))

    @cached_property
    def anomalies(self) -> Array:
        """Members less their mean (N, n); wrapped for angles."""
        return freeze(self.space.difference(self.members, self.mean))

    @cached_property
    def variance(self) -> Array:
        """Sample variance (n,); NaN for a single member."""
        if len(self) < 2:
            return freeze(np.full(self.space.size, np.nan))
        return freeze(np.einsum("ij,ij->j", self.anomalies, self.anomalies) / (len(self) - 1))

    @cached_property
    def spread(self) -> Array:
        """Sample standard deviation (n,); NaN for a single member."""
        return freeze(np.sqrt(self.variance))


@dataclass(frozen=True, eq=False)
class Vehicle:
    """The vehicles as a policy sees them: ``positions`` (V, 2) in metres, ``speed`` in m/s.

    ``dt`` is the time to the next decision in seconds; ``airspace`` is where they may fly, None where nothing limits
    them.
    """

    positions: Array
    speed: float = 0.0
    dt: float = 1.0
    airspace: Domain | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "positions", freeze(self.positions).reshape(-1, 2))

    @property
    def reach(self) -> float:
        """How far a vehicle gets before the next decision, in metres."""
        return self.speed * self.dt

    def moved(self, positions: Array) -> Vehicle:
        """Return the same vehicles at other ``positions`` (V, 2)."""
        return Vehicle(positions, self.speed, self.dt, self.airspace)


@dataclass(frozen=True, eq=False)
class Route:
    """What the vehicles fly until the next decision: for each a polyline (k, 2) in metres that begins where it is.

    ``notes`` are sentences for the log (a vehicle that found every way blocked says so).

    >>> Route((np.array([[0.0, 0.0], [3.0, 4.0]]),)).ends
    array([[3., 4.]])
    """

    paths: tuple[Array, ...] = ()
    memory: Memory | None = None
    diagnostics: Diagnostics = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "paths", tuple(freeze(path).reshape(-1, 2) for path in self.paths))

    @property
    def ends(self) -> Array:
        """Where the vehicles are at the end, (V, 2)."""
        return np.array([path[-1] for path in self.paths]).reshape(-1, 2)

    @classmethod
    def hover(cls, vehicle: Vehicle) -> Route:
        """Return the route on which every vehicle stays where it is."""
        return cls(tuple(position[np.newaxis] for position in vehicle.positions))


@dataclass(frozen=True, eq=False)
class Step:
    """What a model with more to say than its members returns from a step."""

    members: Array
    memory: Memory | None = None
    diagnostics: Diagnostics = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Forecast:
    """An ensemble that a model has stepped, with the model's memory and diagnostics."""

    ensemble: Ensemble
    memory: Memory | None = None
    diagnostics: Diagnostics = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Analysis:
    """What a filter returns: the members (N, n) once the readings are in; what to remember and to record.

    >>> Analysis(np.zeros((2, 1)), diagnostics={"rank": Diagnostic(1)}).members.shape
    (2, 1)
    """

    members: Array
    memory: Memory | None = None
    diagnostics: Diagnostics = field(default_factory=dict)
