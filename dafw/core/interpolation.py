"""Values between the nodes: of one state at given places, and of one state space in another.

On triangles and on a line the interpolation is linear (on triangles by barycentric weights). Otherwise a point takes
the value of the nearest node. So does a point outside of all triangles: rounding may put a node of another mesh at a
wall there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dafw.core.domain import Domain
from dafw.core.ensemble import Ensemble
from dafw.core.errors import ConfigurationError
from dafw.core.observation import ObservationOperator, Selection
from dafw.core.space import Array, IntArray, Kind, StateSpace, Variable


def weights_at(variable: Variable, triangles: NDArray[np.int32] | None, points: Array) -> tuple[IntArray, Array]:
    """Return the interpolation of a variable to ``points`` (m, d): indices of its entries and weights, both (m, k).

    ``triangles`` (faces, 3) connect the entries; None if there are none. Raises ConfigurationError if the variable has
    no coordinates.
    """
    nodes = variable.coordinates
    if nodes is None or nodes.shape[1] != points.shape[1]:
        raise ConfigurationError(f"the variable '{variable.name}' has no places in {points.shape[1]} dimensions")
    if triangles is not None:
        return _in_triangles(variable, triangles, points)
    if nodes.shape[1] == 1:
        return _on_line(nodes[:, 0], points[:, 0])
    nearest = variable.nearest(points)
    return nearest[:, np.newaxis], np.ones((len(points), 1))


def _in_triangles(variable: Variable, triangles: NDArray[np.int32], points: Array) -> tuple[IntArray, Array]:
    inside, corners, weights = in_triangles(np.asarray(variable.coordinates), triangles, points)
    if not inside.all():
        corners[~inside] = variable.nearest(points[~inside])[:, np.newaxis]
        weights[~inside] = [1.0, 0.0, 0.0]
    return corners, weights


def in_triangles(
    nodes: Array, triangles: NDArray[np.int32], points: Array
) -> tuple[NDArray[np.bool_], IntArray, Array]:
    """Return which points (m, 2) are in a triangle, the triangle's corners (m, 3) and the barycentric weights (m, 3).

    ``nodes`` are (n, 2), ``triangles`` (faces, 3). Corners and weights of the other points mean nothing.
    """
    from matplotlib.tri import Triangulation

    face = Triangulation(*nodes.T, triangles).get_trifinder()(*points.T)
    inside = face >= 0
    corners = triangles[np.where(inside, face, 0)].astype(np.int64)
    return inside, corners, barycentric(nodes[corners], points)


def barycentric(corners: Array, points: Array) -> Array:
    """Return the barycentric weights (m, 3) of points (m, 2) in triangles with the ``corners`` (m, 3, 2)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    twice_area = _cross(b - a, c - a)
    weights = np.stack([_cross(b - points, c - points), _cross(c - points, a - points), _cross(a - points, b - points)])
    return np.asarray((weights / twice_area).T)


def points_along(corners: Array, lengths: Array) -> Array:
    """Return the points (m, 2) at the arc lengths (m,) along a polyline with the ``corners`` (k, 2), in metres."""
    at_corners = arc_lengths(corners)
    return np.column_stack([np.interp(lengths, at_corners, corners[:, axis]) for axis in (0, 1)])


def arc_lengths(corners: Array) -> Array:
    """Return the arc length (k,) at each corner of a polyline (k, 2), in metres."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])


def _cross(a: Array, b: Array) -> Array:
    """Return the third component of the cross products of vectors (m, 2) in the plane."""
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _on_line(nodes: Array, points: Array) -> tuple[IntArray, Array]:
    order = np.argsort(nodes)
    after = np.clip(np.searchsorted(nodes[order], points), 1, len(nodes) - 1)
    left, right = order[after - 1], order[after]
    share = np.clip((points - nodes[left]) / (nodes[right] - nodes[left]), 0.0, 1.0)
    return np.stack([left, right], axis=1), np.stack([1.0 - share, share], axis=1)


@dataclass(frozen=True, eq=False)
class View:
    """Maps a state to another state space by a sparse ``matrix`` (m, n); NaN for variables that the state lacks."""

    space: StateSpace
    matrix: Any
    missing: NDArray[np.bool_]

    def of(self, ensemble: Ensemble) -> Ensemble:
        """Return an ensemble (N, n) of the first space as an ensemble (N, m) of the second."""
        return Ensemble(self.members(ensemble.members), self.space, ensemble.time, ensemble.weights)

    def members(self, members: Array) -> Array:
        """Return members (N, n) of the first space as members (N, m) of the second."""
        seen = np.asarray((self.matrix @ members.T).T)
        seen[:, self.missing] = np.nan
        return seen

    def through(self, operator: ObservationOperator) -> ObservationOperator:
        """Return the operator that reads states of the first space as ``operator`` reads those of the second."""
        rows = self.matrix[operator.indices] if isinstance(operator, Selection) else None
        return _Through(
            operator=operator,
            view=self,
            rows=rows,
            covariance=operator.covariance,
            noise_covariance=operator.noise_covariance,
            coordinates=operator.coordinates,
            sensors=operator.sensors,
            limits=operator.limits,
            spans=operator.spans,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Through(ObservationOperator):
    """What ``operator`` reads of the states that a view shows; ``rows`` (m, n) of the view's matrix suffice, if any."""

    operator: ObservationOperator
    view: View
    rows: Any = None

    def apply(self, members: Array) -> Array:
        """Return what each of the members (N, n) would read, (N, m)."""
        if self.rows is None:
            return self.operator.apply(self.view.members(members))
        return np.asarray((self.rows @ members.T).T)


def view(of: StateSpace, of_domain: Domain | None, space: StateSpace, role: str) -> View | None:
    """Return the map from states of the space ``of`` to states of ``space``; None if the spaces agree.

    Variables are matched by name and interpolated in space. Variables that ``of`` does not have are NaN, except the
    first, which is scored and must exist. Raises ConfigurationError, which names the ``role`` of the mapped state, if
    the first variable is missing, of another kind, or cannot be interpolated.
    """
    if of.agrees(space):
        return None
    from scipy.sparse import csr_array

    theirs = {variable.name: variable for variable in of.variables}
    rows, columns, values = [], [], []
    missing = np.ones(space.size, dtype=bool)
    for number, variable in enumerate(space.variables):
        other = theirs.get(variable.name)
        if other is None or other.kind is not variable.kind:
            if number == 0:
                found = "none" if other is None else f"one of the kind {other.kind.value}"
                raise ConfigurationError(
                    f"the {role} must have the variable '{variable.name}' ({variable.kind.value}), it has {found}: "
                    f"{of!r}"
                )
            continue
        indices, weights = _from_variable(other, variable, of, of_domain, role)
        part = space.slice(variable.name)
        rows.append(np.repeat(np.arange(part.start, part.stop), indices.shape[1]))
        columns.append(indices.ravel() + of.slice(variable.name).start)
        values.append(weights.ravel())
        missing[part] = False
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return View(space, csr_array(entries, shape=(space.size, of.size)), missing)


def _from_variable(
    other: Variable, variable: Variable, of: StateSpace, domain: Domain | None, role: str
) -> tuple[IntArray, Array]:
    """Return the interpolation from ``other`` to ``variable``: indices of the entries of ``other``, and weights."""
    same = other.size == variable.size
    if same and variable.coordinates is None and other.coordinates is None:
        return np.arange(variable.size)[:, np.newaxis], np.ones((variable.size, 1))
    if variable.coordinates is None or other.coordinates is None or variable.kind is Kind.ANGLE:
        raise ConfigurationError(
            f"the {role}'s '{variable.name}' has {other.size} numbers, the model's {variable.size}: expected places "
            f"between which plain numbers can be interpolated"
        )
    if same and np.array_equal(other.coordinates, variable.coordinates):
        return np.arange(variable.size)[:, np.newaxis], np.ones((variable.size, 1))
    # The triangles connect the nodes of the first variable.
    triangles = domain.triangles if domain is not None and other is of.variables[0] else None
    return weights_at(other, triangles, variable.coordinates)
