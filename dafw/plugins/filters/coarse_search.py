"""Two fidelities: another filter searches with a coarser version of the model; the model itself carries the belief.

The other filter, the base, is given a study of its own: the coarser model, and the same readings, which operators read
through the map V from the coarser states to those of the model ::

    y = H(V(x)) + e

Its members are coarse ones. Every ``renew`` cycles the belief gets their numbers without places (wind, diffusion, ...)
and their weights. A member whose numbers are those of a member of the forecast has its state; any other is run from the
start with the model itself. In between, the model carries the belief on. So the many runs of the search are cheap, and
those of the model itself are few.

A member that the model itself cannot run has no weight. The others share it in proportion to theirs, and a copy of the
heaviest stands in its place. If the model can run none of the members, its error ends the study.

The numbers without places must be parameters that a run of the model does not change. If the two state spaces agree,
the base's members are the belief as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dafw.core.ensemble import Analysis, Diagnostic, Ensemble, Forecast, Memory
from dafw.core.errors import ConfigurationError, DivergenceError, SolverError
from dafw.core.interfaces import Filter
from dafw.core.observation import Observation
from dafw.core.options import option
from dafw.core.registry import registry
from dafw.core.rerun import Replay
from dafw.core.space import Array, IntArray, StateSpace
from dafw.core.window import Window
from dafw.plugins.filters.candidates import joined_forecasts, rows, without_failures
from dafw.plugins.filters.wrapped import BASE, MODEL, part_of


@dataclass
class CoarseSearch(Filter):
    """Another filter on a coarser version of the model; the model itself runs what was found."""

    window = None
    past_beliefs = "first"
    accuracy = "none"
    inflation_option = None
    uses_coarser = True

    base: dict[str, Any] = option({"name": "amis"}, "the filter that searches: a mapping with its name and options")
    renew: int = option(3, "cycles from one renewal of the belief to the next; meanwhile it is carried on", minimum=1)

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return a base that needs few runs of the model."""
        return {"base": {"name": "amis", "enough": 0.5, "steps": 600, "archive": 3}}

    def __post_init__(self) -> None:
        self._base: Filter = registry().create("filter", self.base)
        if self._base.window is not None or self._base.past_beliefs != "first":
            raise ConfigurationError(
                f"filter 'coarse_search': expected a base that looks back to the start and needs the first belief "
                f"only, such as amis, got {self._base.label}"
            )
        self.weighs_first_guess = self._base.weighs_first_guess

    def require_members(self, n_members: int) -> None:
        """Raise ConfigurationError if the base cannot work with so few members."""
        self._base.require_members(n_members)

    def suit(self, space: StateSpace, n_members: int) -> None:
        """Raise ConfigurationError if the base does not suit."""
        self._base.suit(space, n_members)

    def initial_memory(self, n_members: int) -> Memory | None:
        """Return the base's memory."""
        memory = self._base.initial_memory(n_members)
        return None if memory is None else {f"{BASE}{name}": array for name, array in memory.items()}

    def unfinished(self, memory: Memory | None) -> bool:
        """Return whether the base has more to do, or the belief has not been given yet what it found."""
        return bool((memory or {}).get("waiting", False)) or self._base.unfinished(part_of(memory, BASE))

    def analyse_window(self, window: Window, rng: np.random.Generator) -> Analysis:
        """Return the forecast, or the members that the base found, run with the model itself."""
        number = window.cycles[-1].number
        inner = self._coarse(window)
        found = self._base.look_back(inner, rng)
        coarse = inner.forecast.ensemble.with_members(found.members, found.weights)
        coarse_memory = inner.forecast.memory if found.model_memory is None else found.model_memory
        kept: dict[str, Any] = {"start": inner.first.ensemble.members, "members": coarse.members}
        kept |= {"time": np.array(coarse.time), "done": np.array(number + 1)}
        kept |= {} if coarse.weights is None else {"weights": coarse.weights}
        kept |= {f"{BASE}{name}": array for name, array in (found.memory or {}).items()}
        kept |= {f"{MODEL}{name}": array for name, array in (coarse_memory or {}).items()}
        kept["waiting"] = np.array((number + 1) % self.renew != 0)
        renewed, failed, belief, weights = 0, 0, window.forecast, window.forecast.ensemble.weights
        if (number + 1) % self.renew == 0:
            if window.rerun.view_of_coarser is None:
                belief = Forecast(coarse, coarse_memory)
            else:
                belief, renewed, failed = _run_with_model(window, coarse)
            weights = belief.ensemble.weights
        space = belief.ensemble.space
        members = space.retract(belief.ensemble.members, np.zeros(space.size))
        diagnostics = dict(found.diagnostics)
        diagnostics["renewed"] = Diagnostic(renewed, long_name="members that the model itself ran from the start")
        diagnostics["renewals_failed"] = Diagnostic(failed, long_name="members that the model itself could not run")
        return Analysis(members, kept, diagnostics, weights, model_memory=belief.memory)

    def _coarse(self, window: Window) -> Window:
        """Return the window as the base sees it: with the coarser model and its members."""
        rerun, shown = window.rerun.coarser, window.rerun.view_of_coarser
        memory: Memory = window.memory or {}
        number = window.cycles[-1].number

        def read(observation: Observation) -> Observation:
            if shown is None or not observation.values.size:
                return observation
            return replace(observation, operator=shown.through(observation.operator))

        first = window.first.ensemble
        if "start" in memory:
            start = memory["start"]
        else:
            to_coarser = window.rerun.view_to_coarser
            start = rerun.settled_members(first.members if to_coarser is None else to_coarser.members(first.members))
        before = rerun.with_memory(Ensemble(start, rerun.space, first.time, first.weights))
        cycles = tuple(replace(one, belief=None, observation=read(one.observation)) for one in window.cycles)
        cycles = (cycles[0].with_belief(before), *cycles[1:])
        since = cycles[0].number
        if "done" in memory:
            since = int(memory["done"])
            last = Ensemble(memory["members"], rerun.space, float(memory["time"]), memory.get("weights"))
            before = Forecast(last, part_of(memory, MODEL))
        forecast = rerun(before, since, number + 1).forecast
        predicted = cycles[-1].observation.operator.apply(forecast.ensemble.members)
        predicted.setflags(write=False)
        late = tuple((cycle, read(observation)) for cycle, observation in window.late)
        return Window(cycles, forecast, predicted, late, part_of(memory, BASE), rerun)


def _numbers(space: StateSpace) -> IntArray:
    """Return the indices (k,) of the numbers without places, by the name of their variable."""
    named = sorted(variable.name for variable in space.variables if variable.coordinates is None)
    return np.concatenate([np.empty(0, np.int64), *(np.r_[space.slice(name)] for name in named)])


def _run_with_model(window: Window, coarse: Ensemble) -> tuple[Forecast, int, int]:
    """Return the members with the numbers of coarse ones, now, and with their weights.

    Also how many of them were run from the start, and for how many the model failed; a copy of the heaviest stands for
    each of these. Raises the model's SolverError or DivergenceError if none is left.
    """
    forecast, first = window.forecast, window.first.ensemble
    wanted, places = coarse.members[:, _numbers(coarse.space)], _numbers(first.space)
    there = {row.tobytes(): index for index, row in enumerate(forecast.ensemble.members[:, places])}
    some_are_there = any(row.tobytes() in there for row in wanted)
    missing: dict[bytes, int] = {}
    for index, row in enumerate(wanted):
        if row.tobytes() not in there:
            missing.setdefault(row.tobytes(), index)
    renewed = 0
    if missing:
        new = list(missing.values())
        starts = first.members[new].copy()
        starts[:, places] = wanted[new]
        run, kept = _run_from_start(window, window.rerun.settled_members(starts), may_fail=some_are_there)
        if run is not None:
            there |= {wanted[new[one]].tobytes(): len(forecast.ensemble) + place for place, one in enumerate(kept)}
            forecast = joined_forecasts(forecast, run)
        renewed = len(kept)
    ran, weights = np.array([row.tobytes() in there for row in wanted]), coarse.weights
    if not ran.all():
        weights = _weights_of(ran, weights)
        wanted = np.where(ran[:, np.newaxis], wanted, wanted[np.argmax(weights)])
    belief = rows(forecast, np.array([there[row.tobytes()] for row in wanted]))
    return belief.with_members(belief.ensemble.members, weights), renewed, int(np.count_nonzero(~ran))


def _run_from_start(window: Window, starts: Array, *, may_fail: bool) -> tuple[Forecast | None, IntArray]:
    """Return the members at ``starts`` (M, n) run to now without those for which the model fails, and their indices.

    If it fails for all, return None, or raise the error of the last unless they ``may_fail``.
    """

    def run(kept: IntArray) -> Replay:
        start = window.first.ensemble.with_members(starts[kept])
        return window.rerun(start, window.cycles[0].number, window.cycles[-1].number + 1)

    try:
        replay, kept = without_failures(run, len(starts))
    except (SolverError, DivergenceError) as error:
        if error.member is None or not may_fail:
            raise
        return None, np.empty(0, dtype=np.int64)
    return replay.forecast, kept


def _weights_of(ran: NDArray[np.bool_], weights: Array | None) -> Array:
    """Return weights (N,) with which averages are over the members that ``ran`` (N,); None: all counted equally."""
    shares = np.where(ran, 1.0 if weights is None else weights, 0.0)
    shares = shares if shares.any() else ran.astype(np.float64)
    return np.asarray(shares / shares.sum())
