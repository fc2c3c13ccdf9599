"""Look ahead: fly the straight path along which the members will disagree most by the time the vehicle gets there.

The belief is forecast over a horizon of K cycles, once for all paths. Path h leaves the vehicle at the angle
2 pi h / H, one full leg a cycle, for as long as the way is free; then it waits. In cycle k it reads the nodes j nearest
to a few points along its leg. With the members' predictions c_ij at the end of that cycle and the members' weights w_i,
its score is ::

    sum_k g^(k dt) mean_j v_kj,    v_kj = sum_i w_i (f(c_ij) - sum_l w_l f(c_lj))^2,    f(c) = log(max(c, 0) + c0)

and to it is added what can be seen after the horizon, with the field at the horizon's end and the distance d_j from the
end of the path to node j: max_j g^(K dt + d_j / speed) v_Kj. So a vehicle far away from all disagreement flies towards
it. A variable that may be negative has no logarithm and is compared as it is, f(c) = c.

Where the members agree everywhere, (sum_i w_i f(c_ij) - f(0))^2 takes the place of v: the vehicle flies to where
something is expected. If nothing is expected anywhere, it hovers. Of paths with equal scores it is the first,
counter-clockwise from east.

The variance of a logarithm as the value of a reading follows from a reading's error that is relative above c0 and
absolute below.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dafw.core.ensemble import Diagnostic, Ensemble, Route, Vehicle
from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Policy
from dafw.core.observation import Selection
from dafw.core.options import option
from dafw.core.space import ANGLE, FIELD, Array, StateSpace, Variable
from dafw.core.window import Outlook

EQUAL = 1e-9
"""Scores that differ by less than this share of the best count as equal, so that rounding does not choose the path."""
AGREED = 1e-12
"""Members agree if the variance of their predictions is below this share of the squares."""
SHARES = (1.0, 0.5, 0.25, 0.125)
"""Lengths of a leg, as a share of a full one: the next is tried where no heading is free for the one before."""


@dataclass(frozen=True, eq=False)
class Paths:
    """Straight paths from one place: leg k of path h ends at ``start + min(k, legs[h]) steps[h]``.

    ``start`` (2,) and ``steps`` (H, 2) in metres; ``legs`` (H,) are the legs of each path that are free, up to K. A
    path without a free leg is not allowed.
    """

    start: Array
    steps: Array
    legs: Array

    def places(self, cycle: int, samples: int) -> Array:
        """Return the points (H, samples, 2) at equal distances along leg ``cycle`` (from 1), the last at its end."""
        flown = cycle - 1 + np.arange(1, samples + 1) / samples
        return self.start + np.minimum(flown, self.legs[:, np.newaxis])[..., np.newaxis] * self.steps[:, np.newaxis]

    @property
    def ends(self) -> Array:
        """Where the paths end, (H, 2)."""
        return self.start + self.legs[:, np.newaxis] * self.steps


def free_paths(start: Array, vehicle: Vehicle, headings: int, cycles: int) -> Paths:
    """Return the straight paths from ``start`` (2,), with the longest legs for which at least one heading is free."""
    angles = np.arange(headings) * 2.0 * np.pi / headings
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    paths = Paths(start, directions, np.zeros(headings))
    for share in SHARES:
        steps = share * vehicle.reach * directions
        legs = np.array([free_legs(start, step, vehicle, cycles) for step in steps], dtype=np.float64)
        paths = Paths(start, steps, legs)
        if legs.any():
            break
    return paths


def free_legs(start: Array, step: Array, vehicle: Vehicle, cycles: int) -> int:
    """Return how many legs ``step`` (2,) in a row are free, at most ``cycles``; none if the vehicle does not move."""
    if not step.any():
        return 0
    if vehicle.airspace is None:
        return cycles
    if not vehicle.airspace.is_free(start, start + step):
        return 0
    if vehicle.airspace.is_free(start, start + cycles * step):
        return cycles
    legs = 1
    while legs < cycles - 1 and vehicle.airspace.is_free(start + legs * step, start + (legs + 1) * step):
        legs += 1
    return legs


@dataclass
class LookAhead(Policy):
    """Compares straight paths by how much the members' predictions along them differ."""

    looks_ahead = True

    horizon: float = option(25.0, "how far to look ahead, in seconds", above=0.0)
    headings: int = option(24, "number H of headings that are compared", minimum=1)
    discount: float = option(0.95, "weight g of a difference that is seen a second later", above=0.0, maximum=1.0)
    floor: float = option(0.01, "c0, in units of the variable: smaller differences count little", above=0.0)
    samples: int = option(2, "points a step along a path at which predictions are compared", minimum=1)
    variable: str | None = option(None, "state variable that is compared; null: the first with places in the plane")

    def suit(self, space: StateSpace) -> None:
        """Raise ConfigurationError if the variable does not exist, has no places in the plane, or holds angles."""
        variable, _ = self._variable(space)
        if variable.kind is ANGLE:
            raise ConfigurationError(f"{self.label}: the variable '{variable.name}' holds angles, which have no order")

    def _variable(self, space: StateSpace) -> tuple[Variable, Array]:
        """Return the variable that is compared and its coordinates (M, 2)."""
        name = self.variable
        if name is None:
            placed = (v.name for v in space.variables if v.coordinates is not None and v.coordinates.shape[1] == 2)
            name = next(placed, space.variables[0].name)
        coordinates = self.require_places(space, name)
        return space[name], coordinates

    def plan(self, outlook: Outlook, rng: np.random.Generator) -> Route:
        """Return the first leg of the best path for each vehicle, decided independently of the others."""
        vehicle, n_vehicles = outlook.vehicle, len(outlook.vehicle.positions)
        cycles = max(1, round(self.horizon / vehicle.dt))
        paths = [free_paths(position, vehicle, self.headings, cycles) for position in vehicle.positions]
        scores = np.full((n_vehicles, self.headings), -np.inf)
        if any(one.legs.any() for one in paths):
            scores = self._scores(outlook, paths, cycles)
        routes, notes = [], []
        for number, (one, values) in enumerate(zip(paths, scores, strict=True)):
            position = vehicle.positions[number]
            if values.max() > 0.0:
                best = int(np.argmax(values >= values.max() * (1.0 - EQUAL)))
                routes.append(np.array([position, position + one.steps[best]]))
                continue
            routes.append(position[np.newaxis])
            reason = "nothing is expected anywhere" if one.legs.any() else "every way is blocked"
            notes.append(f"vehicle {number} hovers at {position.round(1).tolist()}: {reason}")
        recorded = Diagnostic(scores, ("vehicle", "heading"), long_name="score of each heading at the decision")
        return Route(tuple(routes), diagnostics={"heading_score": recorded}, notes=tuple(notes))

    def _scores(self, outlook: Outlook, paths: Sequence[Paths], cycles: int) -> Array:
        """Return the scores (V, H) of all headings; minus infinity for one whose first leg is blocked."""
        belief, dt = outlook.belief.ensemble, outlook.vehicle.dt
        variable, coordinates = self._variable(belief.space)
        part = belief.space.slice(variable.name)
        operators = []
        for cycle in range(1, cycles + 1):
            places = np.stack([one.places(cycle, self.samples) for one in paths])
            nodes = variable.nearest(places.reshape(-1, 2)) + part.start
            operators.append(Selection(indices=nodes, covariance=np.ones(len(nodes))))
        ahead = outlook.ahead(cycles, operators)
        along = np.stack([ahead.predicted[outlook.cycle + cycle] for cycle in range(cycles)], axis=1)
        along = along.reshape(len(belief), cycles, len(paths), self.headings, self.samples)
        field = ahead.forecast.ensemble.members[:, part]
        seen, later = self._gains(belief, variable, along, field)

        times = dt * np.arange(1, cycles + 1)
        scores = np.tensordot(self.discount**times, seen.mean(axis=-1), axes=1)
        for number, one in enumerate(paths):
            distance = np.linalg.norm(one.ends[:, np.newaxis] - coordinates, axis=2)
            arrival = times[-1] + distance / max(outlook.vehicle.speed, 1e-12)
            scores[number] += (self.discount**arrival * later).max(axis=1)
            scores[number, one.legs == 0] = -np.inf
        return scores

    def _gains(self, belief: Ensemble, variable: Variable, along: Array, field: Array) -> tuple[Array, Array]:
        """Return the worth (...) of readings ``along`` (N, ...) the paths, and (M,) of the ``field`` (N, M) later."""
        values = [along, field]
        nothing = 0.0
        if variable.kind is not FIELD:
            values = [np.log(np.maximum(one, 0.0) + self.floor) for one in values]
            nothing = np.log(self.floor)
        means = [belief.average(one) for one in values]
        variances = [belief.average((one - mean) ** 2) for one, mean in zip(values, means, strict=True)]
        squares = [(mean - nothing) ** 2 for mean in means]
        agreed = all(v.max() <= AGREED * s.max() for v, s in zip(variances, squares, strict=True))
        first, last = squares if agreed else variances
        return first, last
