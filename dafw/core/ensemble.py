"""Frozen value types that travel through a cycle: ``Ensemble``, ``Vehicle``, ``Route``, ``Step``, ``Analysis``.

Arrays inside them are read-only; to change a value, make a new one. What a plugin must remember from one call to the
next is a ``Memory``: named arrays that the plugin returns and is given again, never something hidden on ``self``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from dafw.core.domain import Domain
from dafw.core.errors import ContractError
from dafw.core.quantiles import quantile
from dafw.core.space import Array, StateSpace

type Memory = Mapping[str, Any]


def freeze(array: Any) -> Array:
    """Return ``array`` as read-only float64 in C order. The order is fixed because it decides the bits of sums.

    A writable array is copied, so that the caller can still write to the original without changing the result.
    """
    frozen = np.asarray(array, dtype=np.float64, order="C")
    if frozen.flags.writeable:
        frozen = frozen.copy() if isinstance(array, np.ndarray) else frozen
        frozen.setflags(write=False)
    return frozen


def handed_over(fresh: Array) -> Array:
    """Make an array read-only without a copy, and return it; the caller must not write to it any more."""
    fresh.setflags(write=False)
    return fresh


def points(array: Any, what: str) -> Array:
    """Return ``array`` as read-only points (k, 2) in metres; raises ContractError, which calls them ``what``."""
    frozen = freeze(array)
    if frozen.size == 0:
        return frozen.reshape(0, 2)
    if frozen.ndim != 2 or frozen.shape[1] != 2:
        raise ContractError(f"{what} must be points (k, 2) in metres, got the shape {frozen.shape}")
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

    ``weights`` (N,) add up to one; without them all members count equally. Raises ContractError for weights that are
    negative, not finite, not N in number or do not add up to one.

    >>> belief = Ensemble([[1.0, 0.1], [3.0, 6.2]], StateSpace([Variable("x", 1), Variable("angle", 1, ANGLE)]))
    >>> belief.mean.round(3), belief.spread.round(3)
    (array([2.   , 0.008]), array([1.414, 0.13 ]))
    >>> Ensemble(belief.members, belief.space, weights=[0.75, 0.25]).mean[0]
    np.float64(1.5)
    """

    members: Array
    space: StateSpace
    time: float = 0.0
    weights: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "members", freeze(self.members))
        if self.weights is None:
            return
        weights = freeze(self.weights)
        if weights.shape != (len(self.members),):
            raise ContractError(f"{len(self.members)} members must have as many weights, got the shape {weights.shape}")
        if not ((weights >= 0.0).all() and abs(weights.sum() - 1.0) <= 1e-9):
            raise ContractError(f"weights must not be negative and must add up to 1, got {weights.tolist()}")
        object.__setattr__(self, "weights", weights)

    def __len__(self) -> int:
        return len(self.members)

    @cached_property
    def mean(self) -> Array:
        """The mean (n,); circular for angles."""
        return handed_over(self.space.mean(self.members, self.weights))

    @cached_property
    def anomalies(self) -> Array:
        """Members less their mean (N, n); wrapped for angles."""
        return handed_over(self.space.difference(self.members, self.mean))

    @cached_property
    def variance(self) -> Array:
        """Sample variance (n,), unbiased for independent members; NaN for a single member.

        With weights w it is the weighted mean square divided by 1 - sum w^2; zero if one member has all the weight.
        """
        if len(self) < 2:
            return handed_over(np.full(self.space.size, np.nan))
        if self.weights is None:
            return handed_over(np.einsum("ij,ij->j", self.anomalies, self.anomalies) / (len(self) - 1))
        rest = 1.0 - self.weights @ self.weights
        mean_square = np.einsum("i,ij,ij->j", self.weights, self.anomalies, self.anomalies)
        return handed_over(mean_square / rest if rest > 1e-12 else np.zeros(self.space.size))

    @cached_property
    def spread(self) -> Array:
        """Sample standard deviation (n,); NaN for a single member."""
        return handed_over(np.sqrt(self.variance))

    @property
    def effective_size(self) -> float:
        """The effective sample size 1 / sum w^2: N for equal weights, 1 if one member has all the weight."""
        return float(len(self)) if self.weights is None else float(1.0 / (self.weights @ self.weights))

    def quantile(self, probability: float) -> Array:
        """Return the quantile (n,) of every number; angles are measured from their circular mean.

        With weights it is the smallest member at which the cumulative weight reaches ``probability``, up to rounding.
        """
        if self.weights is None:
            deviation = np.quantile(self.anomalies, probability, axis=0)
        else:
            deviation = quantile(self.anomalies, self.weights, probability)
        return handed_over(self.space.retract(self.mean, deviation))

    def average(self, values: Array) -> Array:
        """Return the mean (...) over the members of plain numbers ``values`` (N, ...), such as predicted readings."""
        if self.weights is None:
            return np.asarray(np.add.reduce(values, axis=0) / len(values))
        return np.asarray(np.tensordot(self.weights, values, axes=1))

    def with_members(self, members: Array, weights: Array | None = None) -> Ensemble:
        """Return other members (M, n) of the same space at the same time."""
        return Ensemble(members, self.space, self.time, weights)


@dataclass(frozen=True, eq=False)
class Vehicle:
    """The vehicles as a policy sees them: ``positions`` (V, 2) in metres, ``speed`` in m/s.

    ``dt`` is the time to the next decision in seconds; ``airspace`` is where they may fly, None for anywhere. Raises
    ContractError for positions of another shape.
    """

    positions: Array
    speed: float = 0.0
    dt: float = 1.0
    airspace: Domain | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "positions", points(self.positions, "the positions of vehicles"))

    @property
    def reach(self) -> float:
        """How far a vehicle gets before the next decision, in metres."""
        return self.speed * self.dt

    def moved(self, positions: Array) -> Vehicle:
        """Return the same vehicles at other ``positions`` (V, 2)."""
        return Vehicle(positions, self.speed, self.dt, self.airspace)


@dataclass(frozen=True, eq=False)
class Route:
    """What the vehicles fly until the next decision: one polyline (k, 2) in metres each, from the vehicle's position.

    ``notes`` are sentences for the log, for example that a vehicle found every way blocked. ``dt`` is the duration of
    the route in seconds; the framework sets it before it calls an observer. Raises ContractError for paths of another
    shape.

    >>> Route((np.array([[0.0, 0.0], [3.0, 4.0]]),)).ends
    array([[3., 4.]])
    """

    paths: tuple[Array, ...] = ()
    memory: Memory | None = None
    diagnostics: Diagnostics = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    dt: float = 0.0

    def __post_init__(self) -> None:
        paths = tuple(points(path, f"the path of vehicle {number}") for number, path in enumerate(self.paths))
        object.__setattr__(self, "paths", paths)

    @property
    def ends(self) -> Array:
        """Where the vehicles are at the end, (V, 2)."""
        return handed_over(np.array([path[-1] for path in self.paths]).reshape(-1, 2))

    @classmethod
    def hover(cls, vehicle: Vehicle) -> Route:
        """Return the route on which every vehicle stays where it is."""
        return cls(tuple(vehicle.positions[:, np.newaxis]), dt=vehicle.dt)


@dataclass(frozen=True, eq=False)
class Step:
    """What a model returns from a step if it has memory or diagnostics to return beside its members."""

    members: Array
    memory: Memory | None = None
    diagnostics: Diagnostics = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Forecast:
    """An ensemble that a model has stepped, with the model's memory and diagnostics.

    A belief after an analysis has the same type; its memory is the one that the model's next step starts from.
    """

    ensemble: Ensemble
    memory: Memory | None = None
    diagnostics: Diagnostics = field(default_factory=dict)

    def with_members(self, members: Array, weights: Array | None = None) -> Forecast:
        """Return other members (N, n), as many as before, with the same memory."""
        return replace(self, ensemble=self.ensemble.with_members(members, weights))


@dataclass(frozen=True, eq=False)
class Analysis:
    """What a filter returns: the members (N, n) after the analysis, what to remember and what to record.

    ``weights`` (N,) add up to one; None: all members count equally. A filter that looks back may also return
    ``revised``, beliefs at earlier times, keyed by the number of cycles done by then, and ``model_memory``, which
    belongs to the new members; None: the forecast's memory is kept.

    >>> Analysis(np.zeros((2, 1)), diagnostics={"rank": Diagnostic(1)}).members.shape
    (2, 1)
    """

    members: Array
    memory: Memory | None = None
    diagnostics: Diagnostics = field(default_factory=dict)
    weights: Array | None = None
    revised: Mapping[int, Forecast] = field(default_factory=dict)
    model_memory: Memory | None = None
