"""Look ahead: fly the straight path along which the members will disagree most by the time the vehicle gets there.

The belief is forecast over a horizon of K cycles, once for all paths. Path h leaves the vehicle at the angle
2 pi h / H, one full leg a cycle, for as long as the way is free; then it waits. In cycle k it reads the nodes j nearest
to a few points along its leg. With the members' predictions c_ij at the end of that cycle and the members' weights w_i,
its score is ::

    sum_k g^(k dt) mean_j v_kj,    v_kj = sum_i w_i (f(c_ij) - sum_l w_l f(c_lj))^2,    f(c) = log(max(c, 0) + c0)

To it is added what can be seen after the horizon, with the field at the horizon's end and the shortest way d_j around
buildings from the end of the path to node j: max_j g^(K dt + d_j / speed) v_Kj. So a vehicle far away from all
disagreement flies towards it. A variable that may be negative has no logarithm and is compared as it is, f(c) = c.

Where the members agree everywhere, (sum_i w_i f(c_ij) - f(0))^2 takes the place of v: the vehicle flies to where
something is expected. If nothing is expected anywhere, it hovers. Of paths with equal scores it is the first,
counter-clockwise from east.

The variance of a logarithm as the value of a reading follows from a reading's error that is relative above c0 and
absolute below.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dafw.core.domain import Domain
from dafw.core.ensemble import Diagnostic, Ensemble, Route, Vehicle
from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Policy
from dafw.core.observation import Selection
from dafw.core.options import option
from dafw.core.space import ANGLE, FIELD, Array, IntArray, StateSpace, Variable
from dafw.core.ways import Ways
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
    legs: IntArray

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
    paths = Paths(start, directions, np.zeros(headings, dtype=np.int64))
    for share in SHARES:
        steps = share * vehicle.reach * directions
        paths = Paths(start, steps, free_legs(start, steps, vehicle, cycles))
        if paths.legs.any():
            break
    return paths


def free_legs(start: Array, steps: Array, vehicle: Vehicle, cycles: int) -> IntArray:
    """Return how many legs (H,) of each of the steps (H, 2) are free in a row, up to ``cycles``.

    None is if the vehicle does not move.
    """
    if not steps.any():
        return np.zeros(len(steps), dtype=np.int64)
    if vehicle.airspace is None:
        return np.full(len(steps), cycles)
    corners = start + np.arange(cycles + 1)[:, np.newaxis, np.newaxis] * steps
    free = vehicle.airspace.are_free(corners[:-1].reshape(-1, 2), corners[1:].reshape(-1, 2)).reshape(cycles, -1)
    return np.logical_and.accumulate(free).sum(axis=0)


def worth_later(places: Array, worth: Array, nodes: Array, loss: float, airspace: Domain | None) -> Array:
    """Return the most (m,) that is to be had from each of the ``places`` (m, 2): max_j worth_j exp(-loss d_j).

    ``worth`` (M,) is what there is at the ``nodes`` (M, 2); a metre of the way d_j costs the share ``loss`` of it. The
    way leads around obstacles; it is the straight one if none of the places has such a way.
    """
    with np.errstate(divide="ignore"):
        costs = -np.log(worth)
    if airspace is not None and airspace.obstacles:
        around = _costs_around(airspace.ways, places, costs, nodes, loss)
        if np.isfinite(around).any():
            return np.asarray(np.exp(-around))
    distances = np.linalg.norm(places[:, np.newaxis] - nodes, axis=2)
    return np.asarray(np.exp(-(costs + loss * distances).min(axis=1)))


def _costs_around(ways: Ways, places: Array, costs: Array, nodes: Array, loss: float) -> Array:
    """Return min_j (costs_j + loss d_j) (m,) with the ways d_j around obstacles, which begin and end off the grid."""
    points, distances = ways.nearest(nodes)
    at_points = np.full(len(ways.points), np.inf)
    np.minimum.at(at_points, points, costs + loss * distances)
    least = ways.least(at_points, loss)
    points, distances = ways.nearest(places)
    return np.asarray(least[points] + loss * distances)


def can_fly(vehicle: Vehicle, steps: Array) -> bool:
    """Return whether every vehicle can fly its step of ``steps`` (V, 2), in metres, from where it is.

    A path was free when it was chosen. But in a live run a drone may be elsewhere by now, because it waited for advice
    or was blown off its way.
    """
    places, airspace = vehicle.positions, vehicle.airspace
    return airspace is None or bool(airspace.are_free(places, places + steps).all())


def onward(vehicle: Vehicle, steps: Array, left: IntArray) -> Route:
    """Return the next leg of each vehicle, ``steps`` (V, 2) in metres, of ``left`` (V,) legs; it hovers if none is."""
    legs = zip(vehicle.positions, steps, left, strict=True)
    paths = tuple(np.array([place, place + step] if more else [place]) for place, step, more in legs)
    return Route(paths, memory={"steps": steps, "left": np.maximum(left - 1, 0)})


@dataclass
class LookAhead(Policy):
    """Compares straight paths by how much the members' predictions along them differ."""

    looks_ahead = True

    horizon: float = option(25.0, "how far to look ahead, in seconds", above=0.0)
    legs: int = option(3, "legs of the best path, one a cycle, that are flown before the next decision", minimum=1)
    headings: int = option(24, "number H of headings that are compared", minimum=1)
    discount: float = option(0.95, "weight g of a difference that is seen a second later", above=0.0, maximum=0.99)
    floor: float = option(0.01, "c0, in units of the variable: smaller differences count little", above=0.0)
    samples: int = option(2, "points a step along a path at which predictions are compared", minimum=1)
    variable: str | None = option(None, "state variable that is compared; null: the first with places in the plane")
    coarser: bool = option(False, "forecast with the coarser version of the model, which must have one")

    @property
    def uses_coarser(self) -> bool:  # type: ignore[override]  # it depends on the options
        """Whether the coarser version of the model is needed."""
        return self.coarser

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return a short horizon."""
        return {"horizon": 4.0}

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
        """Return the next leg of the best path for each vehicle, decided independently of the others."""
        vehicle, n_vehicles, decided = outlook.vehicle, len(outlook.vehicle.positions), outlook.memory
        if not n_vehicles:
            return Route(())
        if decided is not None and decided["left"].all() and can_fly(vehicle, decided["steps"]):
            return onward(vehicle, decided["steps"], decided["left"])
        cycles = max(1, round(self.horizon / vehicle.dt))
        paths = [free_paths(position, vehicle, self.headings, cycles) for position in vehicle.positions]
        scores = np.full((n_vehicles, self.headings), -np.inf)
        if any(one.legs.any() for one in paths):
            scores = self._scores(outlook, paths, cycles)
        steps, left = np.zeros((n_vehicles, 2)), np.zeros(n_vehicles, dtype=np.int64)
        notes = []
        for number, (one, values) in enumerate(zip(paths, scores, strict=True)):
            position = vehicle.positions[number]
            if values.max() > 0.0:
                best = int(np.argmax(values >= values.max() * (1.0 - EQUAL)))
                steps[number], left[number] = one.steps[best], min(self.legs, one.legs[best])
                continue
            reason = "nothing is expected anywhere" if one.legs.any() else "every way is blocked"
            notes.append(f"vehicle {number} hovers at {position.round(1).tolist()}: {reason}")
        recorded = Diagnostic(scores, ("vehicle", "heading"), long_name="score of each heading at the decision")
        return replace(onward(vehicle, steps, left), diagnostics={"heading_score": recorded}, notes=tuple(notes))

    def _scores(self, outlook: Outlook, paths: Sequence[Paths], cycles: int) -> Array:
        """Return the scores (V, H) of all headings; minus infinity for one whose first leg is blocked."""
        if self.coarser:
            outlook = outlook.on_coarser()
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
        loss = -np.log(self.discount) / outlook.vehicle.speed
        for number, one in enumerate(paths):
            afterwards = worth_later(one.ends, later, coordinates, loss, outlook.vehicle.airspace)
            scores[number] += self.discount ** times[-1] * afterwards
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
