"""Observation operators and observations. R is always a covariance: (m,) where diagonal, else (m, m).

An operator has two covariances: ``covariance`` is given to the filter; the noise of a twin experiment's readings is
drawn from ``noise_covariance``. They are the same unless a study makes them differ, as the paper does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dafw.core.covariances import block_diagonal
from dafw.core.ensemble import Diagnostics, freeze
from dafw.core.errors import ConfigurationError, ContractError
from dafw.core.space import Array, IntArray


@dataclass(frozen=True, eq=False, kw_only=True)
class ObservationOperator:
    """Base of all operators H. ``coordinates`` (m, d) are the places of the readings; NaN or None without a place.

    ``diagnostics`` are what an observer reports about the cycle, recorded under ``observer``. ``sensors`` (m) name the
    sensor that takes each reading, the same one in every cycle; the readings of a sensor stand in the order in which it
    takes them, at equal intervals. None: not told. ``limits`` (m,) are the detection limits of those readings that were
    below theirs, NaN for all others; None: none was. The value of such a reading is midway between the sensor's zero
    and its limit (``below_limit``), so that a filter need not know of limits. ``spans`` (m,) are the seconds, until a
    reading is taken, over which it is a mean; a re-run predicts such means (spans.py). None: no reading is one.

    Raises ConfigurationError for a covariance that is neither (m,) nor (m, m) or whose diagonal is not above zero, and
    if there are not m sensors, limits or spans.
    """

    covariance: Array
    noise_covariance: Array | None = None
    coordinates: Array | None = None
    diagnostics: Diagnostics = field(default_factory=dict)
    sensors: tuple[str, ...] | None = None
    limits: Array | None = None
    spans: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariance", freeze(self.covariance))
        matrices = [("covariance", self.covariance)]
        if self.noise_covariance is not None:
            object.__setattr__(self, "noise_covariance", freeze(self.noise_covariance))
            matrices.append(("noise covariance", self.noise))
        for label, matrix in matrices:
            if matrix.shape not in ((self.size,), (self.size, self.size)):
                raise ConfigurationError(f"the {label} of {self.size} readings has the shape {matrix.shape}")
            variances = matrix if matrix.ndim == 1 else np.diag(matrix)
            if not (variances > 0.0).all():
                raise ConfigurationError(f"the {label} has a variance that is not above zero: {variances.min()}")
        if self.coordinates is not None and (self.coordinates.ndim != 2 or len(self.coordinates) != self.size):
            raise ConfigurationError(
                f"coordinates of {self.size} readings must have the shape ({self.size}, d), "
                f"got {self.coordinates.shape}"
            )
        if self.sensors is not None and len(self.sensors) != self.size:
            raise ConfigurationError(f"{self.size} readings must name {self.size} sensors, got {len(self.sensors)}")
        if self.limits is not None and self.limits.shape != (self.size,):
            raise ConfigurationError(
                f"{self.size} readings must have {self.size} detection limits, got the shape {self.limits.shape}"
            )
        if self.spans is not None and self.spans.shape != (self.size,):
            raise ConfigurationError(
                f"{self.size} readings must have {self.size} spans, got the shape {self.spans.shape}"
            )

    @property
    def size(self) -> int:
        """How many readings, m."""
        return len(self.covariance)

    def apply(self, members: Array) -> Array:
        """Return what each of the members (N, n) would read, (N, m)."""
        raise NotImplementedError(f"{type(self).__name__} must define apply(members)")

    @property
    def entries(self) -> IntArray:
        """The entries of the state of which readings are weighted sums; none if they are functions of another kind."""
        return np.empty(0, dtype=np.int64)

    @property
    def noise(self) -> Array:
        """The covariance of the noise that readings are drawn with: (m,) if diagonal, else (m, m)."""
        return self.covariance if self.noise_covariance is None else self.noise_covariance


@dataclass(frozen=True, eq=False, kw_only=True)
class Selection(ObservationOperator):
    """H in {0, 1}: reads the entries ``indices`` (m,) of the state."""

    indices: IntArray

    @property
    def entries(self) -> IntArray:
        """The selected entries."""
        return self.indices

    def apply(self, members: Array) -> Array:
        """Return the selected columns (N, m)."""
        return members[:, self.indices]


@dataclass(frozen=True, eq=False, kw_only=True)
class Interpolation(ObservationOperator):
    """Reads weighted sums of a few entries: reading i is sum_k weights[i, k] state[indices[i, k]], both (m, k)."""

    indices: IntArray
    weights: Array

    @property
    def entries(self) -> IntArray:
        """The entries that have a weight."""
        return np.asarray(self.indices[self.weights != 0.0])

    def apply(self, members: Array) -> Array:
        """Return the interpolated values (N, m)."""
        return np.asarray(np.einsum("imk,mk->im", members[:, self.indices], self.weights))


@dataclass(frozen=True, eq=False, kw_only=True)
class Stacked(ObservationOperator):
    """Several operators, one below the other; their errors are independent of each other."""

    parts: tuple[ObservationOperator, ...]

    @property
    def entries(self) -> IntArray:
        """The entries of all parts."""
        return np.concatenate([part.entries for part in self.parts])

    def apply(self, members: Array) -> Array:
        """Return the parts' readings side by side (N, m)."""
        return np.concatenate([part.apply(members) for part in self.parts], axis=1)


def stack(parts: tuple[ObservationOperator, ...], *, same_sensors: bool = False) -> ObservationOperator:
    """Return one operator for all parts, in their order. Of diagnostics with the same name the first is kept.

    Sensors are named after the number of their part: those of the second are ``1 drone 0``, ... With ``same_sensors``
    a name means the same sensor in every part.
    """
    coordinates = _stacked_coordinates(parts)
    covariance = block_diagonal([part.covariance for part in parts])
    noise = None
    if any(part.noise_covariance is not None for part in parts):
        noise = block_diagonal([part.noise for part in parts])
    diagnostics = {name: value for part in reversed(parts) for name, value in part.diagnostics.items()}
    sensors = _stacked_sensors(parts, same_sensors)
    limits = None
    if any(part.limits is not None for part in parts):
        limits = np.concatenate([np.full(p.size, np.nan) if p.limits is None else p.limits for p in parts])
    spans = None
    if any(part.spans is not None for part in parts):
        spans = np.concatenate([np.zeros(p.size) if p.spans is None else p.spans for p in parts])
    common: dict[str, Any] = {
        "covariance": covariance,
        "noise_covariance": noise,
        "coordinates": coordinates,
        "diagnostics": diagnostics,
        "sensors": sensors,
        "limits": limits,
        "spans": spans,
    }
    # One operator with large arrays instead of many with small ones: a filter may keep those of all cycles.
    if all(isinstance(part, Selection) for part in parts):
        indices = np.concatenate([part.indices for part in parts if isinstance(part, Selection)])
        return Selection(indices=indices, **common)
    entries = {part.indices.shape[1] if isinstance(part, Interpolation) else 0 for part in parts}
    if len(entries) == 1 and 0 not in entries:
        several = [part for part in parts if isinstance(part, Interpolation)]
        indices = np.concatenate([part.indices for part in several])
        return Interpolation(indices=indices, weights=np.concatenate([part.weights for part in several]), **common)
    return Stacked(parts=parts, **common)


def below_limit(limits: Array, variances: Array) -> tuple[Array, Array]:
    """Return what stands for readings of which it is only known that they are between 0 and the ``limits`` (m,).

    Their values are the middle, L / 2; to the ``variances`` (m,) that of a uniform distribution is added, L^2 / 12.
    """
    return limits / 2.0, variances + limits**2 / 12.0


def nothing() -> Selection:
    """Return the operator of no readings at all."""
    return Selection(indices=np.empty(0, dtype=np.int64), covariance=np.empty(0))


def _stacked_coordinates(parts: tuple[ObservationOperator, ...]) -> Array | None:
    """Return the places (m, d) of all readings, NaN for readings without one; None if no reading has a place."""
    placed = [part.coordinates for part in parts if part.coordinates is not None and part.size]
    if not placed:
        return None
    nowhere = (np.full((part.size, placed[0].shape[1]), np.nan) for part in parts)
    given = (part.coordinates if part.size else None for part in parts)
    return np.concatenate([n if c is None else c for n, c in zip(nowhere, given, strict=True)])


def _stacked_sensors(parts: tuple[ObservationOperator, ...], same: bool) -> tuple[str, ...] | None:
    """Return the names of all readings' sensors; None if a part does not tell them."""
    names: list[str] = []
    for number, part in enumerate(parts):
        if part.sensors is None and part.size:
            return None
        names += [sensor if same else f"{number} {sensor}" for sensor in part.sensors or ()]
    return tuple(names)


@dataclass(frozen=True, eq=False)
class Observation:
    """Readings ``values`` (m,) at a ``time`` (s), with the operator that made them.

    >>> seen = Observation([3.0], Selection(indices=np.array([0]), covariance=np.array([0.25])), time=2.0)
    >>> seen.values, seen.covariance
    (array([3.]), array([0.25]))
    """

    values: Array
    operator: ObservationOperator
    time: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", freeze(self.values))
        if self.values.shape != (self.operator.size,):
            raise ContractError(
                f"an observation must have the {self.operator.size} values of its operator, "
                f"got the shape {self.values.shape}"
            )

    @property
    def covariance(self) -> Array:
        """R as the filter is told: (m,) where diagonal, else (m, m)."""
        return self.operator.covariance

    @property
    def variance(self) -> Array:
        """The diagonal of R (m,)."""
        return self.covariance if self.covariance.ndim == 1 else np.diag(self.covariance)


def merged_observations(observations: Sequence[Observation], time: float) -> Observation:
    """Return several observations merged into one at ``time`` (s); a single one of that time is returned unchanged."""
    if len(observations) == 1 and observations[0].time == time:
        return observations[0]
    if not observations:
        return Observation(np.empty(0), nothing(), time)
    values = np.concatenate([observation.values for observation in observations])
    return Observation(values, stack(tuple(one.operator for one in observations), same_sensors=True), time)
