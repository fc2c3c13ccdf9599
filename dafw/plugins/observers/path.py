"""Open paths: each reads the mean of a variable along a straight line, as a laser between two points does.

The mean is exact for fields that are linear on the triangles of the mesh (dafw/core/line_means.py). Readings that were
recorded along such lines are mapped in the same way by the option ``paths`` of ``readings=recorded``. Nodes without a
mesh of their own are connected by Delaunay's triangles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dafw.core.ensemble import Route
from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Observer
from dafw.core.line_means import line_mean
from dafw.core.observation import Interpolation, ObservationOperator, nothing
from dafw.core.options import REQUIRED, option
from dafw.core.space import Array, IntArray, StateSpace, Variable
from dafw.plugins.observers.schedule import is_due, require_steps


def ends_of(given: Any, label: str) -> dict[str, Array]:
    """Return by name the ends (2, 2) of lines that options give as [[x, y], [x, y]]; raises ConfigurationError."""
    found = {}
    for name, line in given.items():
        try:
            ends = np.asarray(line, dtype=np.float64)
        except (TypeError, ValueError):
            ends = np.empty(0)
        if ends.shape != (2, 2) or not np.isfinite(ends).all():
            raise ConfigurationError(f"{label}: path '{name}' must be [[x, y], [x, y]] in metres, got {line!r}")
        found[str(name)] = ends
    return found


def line_means(variable: Variable, lines: Sequence[Array], label: str) -> tuple[IntArray, Array]:
    """Return entries of a variable in the plane, and weights, both (lines, k), of its means along lines (2, 2).

    Rows are filled up with zeros. Raises ConfigurationError that begins with ``label`` if a line leaves the mesh,
    or if there can be none.
    """
    nodes, triangles = np.asarray(variable.coordinates), variable.triangles
    if triangles is None:
        from matplotlib.tri import Triangulation

        if np.linalg.matrix_rank(nodes - nodes[0]) < 2:
            raise ConfigurationError(
                f"{label}: the {len(nodes)} places of '{variable.name}' lie on a line, so they have no triangles for a "
                "mean along a path"
            )
        triangles = Triangulation(*nodes.T).triangles
    parts = []
    for start, end in lines:
        try:
            parts.append(line_mean(nodes, triangles, start, end))
        except ConfigurationError as error:
            raise ConfigurationError(f"{label}: {error}") from error
    k = max(len(found) for found, _ in parts)
    indices, weights = np.zeros((len(parts), k), dtype=np.int64), np.zeros((len(parts), k))
    for row, (found, shares) in enumerate(parts):
        indices[row, : len(found)], weights[row, : len(found)] = found, shares
    return indices, weights


@dataclass
class Path(Observer):
    """Instruments that read the mean along lines."""

    paths: dict[str, Any] = option(REQUIRED, "by name: the two ends of a path, [[x, y], [x, y]] in metres")
    every: float | None = option(
        None, "seconds between readings, the first at the end of the first step; null: every step", above=0.0
    )
    variable: str = option("concentration", "state variable that is read; it needs coordinates in the plane")
    noise_sd: float = option(1e-3, "standard deviation of the readings' noise", above=0.0)
    assumed_variance: float | None = option(None, "error variance for the filter; null: noise_sd squared", above=0.0)

    _made: tuple[StateSpace, Interpolation] | None = field(default=None, init=False, repr=False, compare=False)

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return two paths that cross."""
        return {"paths": {"a": [[10.0, 10.0], [290.0, 150.0]], "b": [[10.0, 150.0], [290.0, 10.0]]}, "every": 2.0}

    def __post_init__(self) -> None:
        self._ends = ends_of(self.paths, "observer 'path'")
        if not self._ends:
            raise ConfigurationError("observer 'path': paths must name at least one path")

    def suit(self, space: StateSpace, dt: float) -> None:
        """Check the variable's places, the paths and ``every``; raises ConfigurationError."""
        require_steps(self.every, dt, self.label)
        self._operator(space)

    def operator(self, space: StateSpace, route: Route, t: float) -> ObservationOperator:
        """Return the readings due in this step: all paths, or none."""
        return self._operator(space) if is_due(t, self.every, route.dt) else nothing()

    def _operator(self, space: StateSpace) -> Interpolation:
        if self._made is None or self._made[0] is not space:
            self._made = (space, self._of(space))
        return self._made[1]

    def _of(self, space: StateSpace) -> Interpolation:
        self.require_places(space, self.variable)
        indices, weights = line_means(space[self.variable], list(self._ends.values()), self.label)
        variance = self.noise_sd**2
        return Interpolation(
            indices=indices + space.slice(self.variable).start,
            weights=weights,
            covariance=np.full(len(indices), variance if self.assumed_variance is None else self.assumed_variance),
            noise_covariance=np.full(len(indices), variance),
            coordinates=np.array([ends.mean(axis=0) for ends in self._ends.values()]),
            sensors=tuple(self._ends),
        )
