"""Running the belief on from now, and what it says: when every place exceeds thresholds, until when, and its dose.

The members run on through the study's re-run with random streams of their own (role "planning"), so the belief and
all that comes after it stay as they are, to the last bit. Only what is asked for is kept of the steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dafw.core.cycle import FREE_ERROR, TRUTH_ERROR, Parts, State
from dafw.core.ensemble import Ensemble, Forecast
from dafw.core.forecasts.areas import Peaks, Places
from dafw.core.forecasts.plan import ForecastPlan, whole_steps
from dafw.core.interfaces import Model
from dafw.core.space import Array

AT_ONCE = 10
"""Cycles of the members that are kept in memory at once."""


@dataclass(frozen=True)
class Course:
    """What happens at m places (nodes or areas) in N members within the horizon; times are lead times in seconds.

    values     (L, N, m)  values at the lead times
    arrival    (K, N, m)  when each of K thresholds is first exceeded; infinite if it is not
    clearing   (K, N, m)  from when on it is no longer exceeded: 0 if it never is, infinite if it still is at the end
    dose       (N, m)     integral of the value over the horizon, in its units times seconds
    weights    (N,)       of the members; None: all count equally
    """

    values: Array
    arrival: Array
    clearing: Array
    dose: Array
    weights: Array | None = None


@dataclass(frozen=True)
class Ahead:
    """A forecast issued at ``time`` (s): the courses at the nodes, in areas and at buildings."""

    time: float
    nodes: Course
    areas: Course
    buildings: Course


def arrays_of(plan: ForecastPlan) -> int:
    """Return how many arrays of the size of the members a forecast needs at once, about."""
    return AT_ONCE + len(plan.leads) + 3 * len(plan.limits) + 4


def run_ahead(parts: Parts, state: State, plan: ForecastPlan, places: Places) -> tuple[Ahead, dict[str, Ahead]]:
    """Return the forecast of the belief and what ``truth`` and ``free`` run will do.

    Those are run only if the plan verifies and there is a truth to judge by.

    Raises what the models raise; the state and all that is computed from it later stay as they are.
    """
    belief = belief_ahead(parts, state, plan, places)
    if not plan.verify or parts.truth is None:
        return belief, {}
    singles = {name: ahead(parts, state, plan, places) for name, ahead in SINGLES.items()}
    return belief, {name: found for name, found in singles.items() if found is not None}


class _Follower:
    """Follows values (N, m) from one time step to the next and builds a Course."""

    def __init__(self, leads: Sequence[float], thresholds: Sequence[float], dt: float) -> None:
        self._wanted = {whole_steps(lead, dt, "lead_times"): row for row, lead in enumerate(leads)}
        self._limits, self._dt = np.array(thresholds)[:, np.newaxis, np.newaxis], dt
        self._kept: dict[int, Array] = {}
        self._before: Array = np.empty(0)
        self._steps = 0

    def add(self, values: Array) -> None:
        """Add the values at the next time step, those of the issue first."""
        lead = self._steps * self._dt
        above = values > self._limits
        if not self._steps:
            self._arrival = np.full(above.shape, np.inf)
            self._last = np.full(above.shape, -1)
            self._dose = np.zeros(values.shape)
        else:
            self._dose += 0.5 * self._dt * (self._before + values)
        self._arrival = np.where(above, np.minimum(self._arrival, lead), self._arrival)
        self._last = np.where(above, self._steps, self._last)
        if self._steps in self._wanted:
            self._kept[self._wanted[self._steps]] = values.copy()
        self._before = values
        self._steps += 1

    def course(self, weights: Array | None, peaks: Peaks | None = None, dose: Array | None = None) -> Course:
        """Return what was found; the ``dose`` of areas is the largest in them."""
        still = self._last == self._steps - 1
        clearing = np.where(still, np.inf, (self._last + 1) * self._dt)
        kept = np.stack([self._kept[row] for row in range(len(self._wanted))])
        return Course(
            kept, self._arrival, clearing, self._dose if peaks is None or dose is None else peaks.of(dose), weights
        )


class _Followers:
    """Follows the scored variable of an ensemble at nodes, in areas and at buildings."""

    def __init__(self, plan: ForecastPlan, places: Places, dt: float) -> None:
        self._places = places
        self._all = [_Follower(plan.leads, plan.limits, dt) for _ in range(3)]

    def add(self, ensemble: Ensemble) -> None:
        variable = ensemble.space.variables[0]
        field = ensemble.members[:, ensemble.space.slice(variable.name)]
        nodes, areas, buildings = self._all
        nodes.add(field)
        areas.add(self._places.areas.of(field))
        buildings.add(self._places.buildings.of(field))

    def ahead(self, time: float, weights: Array | None) -> Ahead:
        nodes, areas, buildings = self._all
        found = nodes.course(weights)
        return Ahead(
            time,
            found,
            areas.course(weights, self._places.areas, found.dose),
            buildings.course(weights, self._places.buildings, found.dose),
        )


def belief_ahead(parts: Parts, state: State, plan: ForecastPlan, places: Places) -> Ahead:
    """Return the forecast of the belief; raises what the model raises."""
    dt, belief = parts.model.dt, state.belief
    followers = _Followers(plan, places, dt)
    followers.add(belief.ensemble)
    cycle, last = state.cycle, state.cycle + whole_steps(plan.horizon, dt, "horizon")
    now: Forecast = belief
    while cycle < last:
        end = min(last, cycle + AT_ONCE)
        states = parts.rerun(now, cycle, end, role="planning", keep=True).states
        for one in states:
            followers.add(one.ensemble)
        now, cycle = states[-1], end
    return followers.ahead(belief.ensemble.time, belief.ensemble.weights)


def truth_ahead(parts: Parts, state: State, plan: ForecastPlan, places: Places) -> Ahead | None:
    """Return what the truth will do; None if there is none. It is what later cycles compute, and on beyond the end."""
    if parts.truth is None or state.truth is None:
        return None
    return _single_ahead(parts.truth, state.truth, TRUTH_ERROR, parts, state.cycle, plan, places)


def free_ahead(parts: Parts, state: State, plan: ForecastPlan, places: Places) -> Ahead | None:
    """Return what the free run will do; None if there is none."""
    if parts.free is None or state.free is None:
        return None
    return _single_ahead(parts.free, state.free, FREE_ERROR, parts, state.cycle, plan, places)


def _single_ahead(
    model: Model, now: Forecast, role: str, parts: Parts, cycle: int, plan: ForecastPlan, places: Places
) -> Ahead:
    """Run one member of another model on with its own random streams: the same steps that later cycles make."""
    followers, time = _Followers(plan, places, model.dt), now.ensemble.time

    def seen(one: Forecast) -> Ensemble:
        found = parts.seen(one) if model is parts.truth else one.ensemble
        return one.ensemble if found is None else found

    followers.add(seen(now))
    for number in range(whole_steps(plan.horizon, model.dt, "horizon")):
        now = model.forecast(now.ensemble, now.memory, parts.streams.members(role, cycle + number))
        followers.add(seen(now))
    return followers.ahead(time, None)


SINGLES = {"truth": truth_ahead, "free": free_ahead}
"""What else is run ahead, to judge forecasts by."""
