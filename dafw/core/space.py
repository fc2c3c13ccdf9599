"""What the numbers of a state mean, and how to average, subtract and move them.

A state is a plain vector of length n; an ensemble is an array ``members (N, n)``. A ``StateSpace`` says which slice
is which variable and of which kind, so that filters, scores and pictures speak only of ``mean``, ``difference`` and
``retract``:

======================  ==============================  ===================================  =====================
kind                    mean                            difference a - b                     retract x + dx
======================  ==============================  ===================================  =====================
``FIELD``               arithmetic                      a - b                                x + dx
``NONNEGATIVE``         arithmetic                      a - b                                max(0, x + dx)
``POSITIVE``            geometric                       log a - log b                        x exp(dx)
``ANGLE`` (radians)     circular, in [0, 2 pi)          wrapped to [-pi, pi)                 (x + dx) mod 2 pi
======================  ==============================  ===================================  =====================

A positive variable is moved in its logarithm: it never reaches zero, and its spread and differences are relative.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dafw.core.errors import ConfigurationError

type Array = NDArray[np.float64]
type IntArray = NDArray[np.int64]

TWO_PI = 2.0 * np.pi
UNBOUNDED = 1e70
"""Up to this size, numbers are not examined further if no variable has a ``plausible`` value."""


class Kind(Enum):
    """How a variable's numbers behave."""

    FIELD = "field"
    NONNEGATIVE = "nonnegative"
    POSITIVE = "positive"
    ANGLE = "angle"


FIELD, NONNEGATIVE, POSITIVE, ANGLE = Kind.FIELD, Kind.NONNEGATIVE, Kind.POSITIVE, Kind.ANGLE


@dataclass(frozen=True, eq=False)
class Variable:
    """One named slice of the state.

    ``size`` numbers of one ``kind`` in ``units`` (UDUNITS spelling); ``coordinates`` is (size, d) in metres, or None
    if the numbers have no place. ``plausible`` is the largest absolute value that the model itself can produce,
    errors of its scheme included: a belief far beyond it has diverged. ``triangles`` (faces, 3) connect the numbers,
    between which the variable is linear; None if it has no mesh. Raises ConfigurationError if these do not fit
    together.

    >>> Variable("speed", 2, NONNEGATIVE, "m s-1", np.array([[0.0, 0.0], [9.0, 0.0]])).nearest([[7.0, 1.0]])
    array([1])
    """

    name: str
    size: int
    kind: Kind = FIELD
    units: str = "1"
    coordinates: Array | None = None
    long_name: str = ""
    plausible: float = np.inf
    triangles: NDArray[np.int32] | None = None

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise ConfigurationError(f"a variable's name must be an identifier, got {self.name!r}")
        if self.size < 1:
            raise ConfigurationError(f"variable '{self.name}' must have a size of at least 1, got {self.size}")
        if not self.plausible > 0.0:
            raise ConfigurationError(f"variable '{self.name}': plausible must be above zero, got {self.plausible}")
        if self.coordinates is not None and (self.coordinates.ndim != 2 or len(self.coordinates) != self.size):
            raise ConfigurationError(
                f"variable '{self.name}': coordinates must have the shape ({self.size}, d), "
                f"got {self.coordinates.shape}"
            )

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import KDTree

        if self.coordinates is None:
            raise ConfigurationError(f"variable '{self.name}' has no coordinates to be near to")
        return KDTree(self.coordinates)

    def nearest(self, points: Array) -> IntArray:
        """Return for each of the points (m, d) the index (m,) of the nearest entry of this variable."""
        return np.asarray(self._tree.query(points)[1], dtype=np.int64)


class StateSpace:
    """The variables of a state in order. Variables of the same name are refused (ConfigurationError).

    >>> space = StateSpace([Variable("speed", 1, NONNEGATIVE), Variable("direction", 1, ANGLE)])
    >>> space.retract([1.0, 6.0], [-2.0, 1.0]).round(3)
    array([0.   , 0.717])
    """

    def __init__(self, variables: tuple[Variable, ...] | list[Variable]) -> None:
        self.variables = tuple(variables)
        self._slices: dict[str, slice] = {}
        start = 0
        for variable in self.variables:
            if variable.name in self._slices:
                raise ConfigurationError(f"the state space has two variables named '{variable.name}'")
            self._slices[variable.name] = slice(start, start + variable.size)
            start += variable.size
        if start == 0:
            raise ConfigurationError("a state space needs at least one variable")
        self.size = start
        self._named = {variable.name: variable for variable in self.variables}
        self._nonnegative = [self._slices[v.name] for v in self.variables if v.kind is NONNEGATIVE]
        self._positive = [self._slices[v.name] for v in self.variables if v.kind is POSITIVE]
        self._angles = [self._slices[v.name] for v in self.variables if v.kind is ANGLE]
        self._bounded = [(self._slices[v.name], v.plausible) for v in self.variables if v.plausible < np.inf]
        # No number is larger than the root of the sum of all squares. So up to this sum of squares all are plausible.
        self.plausible_squares = min([limit for _, limit in self._bounded], default=UNBOUNDED) ** 2

    def __repr__(self) -> str:
        listed = ", ".join(f"{v.name} ({v.size}, {v.kind.value})" for v in self.variables)
        return f"StateSpace({listed})"

    def agrees(self, other: StateSpace) -> bool:
        """Return whether another space has the same variables at the same coordinates."""
        return len(self.variables) == len(other.variables) and all(
            (mine.name, mine.size, mine.kind) == (theirs.name, theirs.size, theirs.kind)
            and np.array_equal(
                np.empty(0) if mine.coordinates is None else mine.coordinates,
                np.empty(0) if theirs.coordinates is None else theirs.coordinates,
            )
            for mine, theirs in zip(self.variables, other.variables, strict=True)
        )

    def __getitem__(self, name: str) -> Variable:
        """Return the variable of that name; raises ConfigurationError, which lists all names."""
        if name not in self._named:
            raise ConfigurationError(f"no state variable '{name}' (there are: {', '.join(self._named)})")
        return self._named[name]

    def slice(self, name: str) -> slice:
        """Return the slice of the state that holds the variable."""
        if name not in self._slices:
            self[name]  # raises
        return self._slices[name]

    def unpack(self, members: Array) -> dict[str, Array]:
        """Return views (..., size) of ``members`` (..., n) by variable name."""
        return {name: members[..., part] for name, part in self._slices.items()}

    def pack(self, values: Mapping[str, Any]) -> Array:
        """Return (..., n) from one array per variable: (..., size), or (...,) for a variable of size 1."""
        parts = []
        for variable in self.variables:
            part = np.asarray(values[variable.name], dtype=np.float64)
            parts.append(part if part.ndim and part.shape[-1] == variable.size else part[..., np.newaxis])
        lead = np.broadcast_shapes(*(part.shape[:-1] for part in parts))
        return np.concatenate([np.broadcast_to(part, lead + part.shape[-1:]) for part in parts], axis=-1)

    def mean(self, members: Array, weights: Array | None = None) -> Array:
        """Return the mean (n,) over the members (N, n), with ``weights`` (N,) where given.

        Circular for angles, geometric for positive numbers.
        """
        mean = _average(members, weights)
        for part in self._positive:
            mean[part] = np.exp(_average(np.log(members[:, part]), weights))
        for part in self._angles:
            angles = members[:, part]
            mean[part] = _modulo(np.arctan2(_average(np.sin(angles), weights), _average(np.cos(angles), weights)))
        return mean

    def difference(self, a: Array, b: Array) -> Array:
        """Return a - b (..., n); angles wrapped to [-pi, pi), positive numbers in their logarithms."""
        difference: Array = np.subtract(a, b)
        for part in self._positive:
            difference[..., part] = np.log(np.asarray(a)[..., part]) - np.log(np.asarray(b)[..., part])
        for part in self._angles:
            difference[..., part] = _modulo(difference[..., part] + np.pi) - np.pi
        return difference

    def retract(self, x: Array, dx: Array) -> Array:
        """Return x + dx (..., n), moved into the range of each variable.

        Nonnegative numbers are clamped, positive ones multiplied by exp(dx), angles taken mod 2 pi.
        """
        moved: Array = np.add(x, dx)
        for part in self._positive:
            moved[..., part] = np.asarray(x)[..., part] * np.exp(np.asarray(dx)[..., part])
        for part in self._nonnegative:
            np.maximum(moved[..., part], 0.0, out=moved[..., part])
        for part in self._angles:
            moved[..., part] = _modulo(moved[..., part])
        return moved

    def angle_among(self, entries: IntArray) -> str:
        """Return the name of the first angle that is among ``entries`` (m,) of the state; '' if none is."""
        for part in self._angles:
            if ((entries >= part.start) & (entries < part.stop)).any():
                return next(name for name, own in self._slices.items() if own == part)
        return ""

    def excess(self, members: Array) -> float:
        """Return the largest of ``|x| / plausible`` in the members (..., n): above 1 they have diverged.

        Zero if no variable has a ``plausible`` value; NaN if a variable that has one holds NaN.
        """
        largest = 0.0
        for part, limit in self._bounded:
            values = members[..., part]
            # Calling the ufuncs' reduce directly: for small arrays the array methods take three times as long.
            ratio = max(np.maximum.reduce(values, axis=None), -np.minimum.reduce(values, axis=None)) / limit
            if ratio != ratio:
                return float("nan")
            largest = max(largest, float(ratio))
        return largest

    def exceeds(self, members: Array, factor: float) -> bool:
        """Return whether any number of the members (..., n) exceeds ``factor`` times its ``plausible`` value."""
        if not self._bounded or sum_of_squares(members) <= self.plausible_squares * factor**2:
            return False
        return self.excess(members) > factor

    def place_of(self, entry: int) -> str:
        """Return the variable of entry ``entry`` of the state, and the node if the variable has several."""
        name = next(name for name, part in self._slices.items() if part.start <= entry < part.stop)
        node = f" at node {entry - self._slices[name].start}" if self[name].size > 1 else ""
        return f"'{name}'{node}"

    def farthest(self, members: Array) -> tuple[int, int]:
        """Return member and entry of the number (N, n) that is largest relative to its ``plausible`` value.

        If no variable has a ``plausible`` value, it is the number of largest absolute value.
        """
        scale = np.concatenate([np.full(v.size, v.plausible if self._bounded else 1.0) for v in self.variables])
        member, entry = np.unravel_index(np.argmax(np.abs(members) / scale), members.shape)
        return int(member), int(entry)


def sum_of_squares(values: Array) -> float:
    """Return the sum of the squares of an array of any shape; infinite or NaN if one of its numbers is."""
    flat = values.ravel(order="K")
    # ``dot`` takes half the time of ``@`` for small arrays; a cycle has seven such sums.
    return float(flat.dot(flat))


def _average(values: Array, weights: Array | None) -> Array:
    """Return the mean over axis 0 of ``values`` (N, k)."""
    # The first branch computes the same as values.mean(axis=0), at half its overhead.
    average: Array = np.add.reduce(values, axis=0) / len(values) if weights is None else weights @ values
    return average


def _modulo(angle: Array) -> Array:
    """Return the angle in [0, 2 pi). ``np.mod`` alone is not enough: it rounds tiny negative numbers up to 2 pi."""
    reduced = np.mod(angle, TWO_PI)
    return np.where(reduced >= TWO_PI, 0.0, reduced)
