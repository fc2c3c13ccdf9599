"""Candidates: points in the space of the controls, each with its run of the model up to now and how well it fits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from dafw.core.ensemble import Ensemble, Forecast, Memory
from dafw.core.errors import DivergenceError, SolverError
from dafw.core.rerun import Replay
from dafw.core.space import Array, IntArray, StateSpace
from dafw.core.spans import begins
from dafw.core.window import Window
from dafw.plugins.filters.controls import Controls
from dafw.plugins.filters.likelihood import Likelihood
from dafw.plugins.filters.slow_sensors import fit_of_slow_sensors

MODEL = "model "
"""Prefix of the model's memory among the arrays of ``Candidates.to_memory``."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """P candidates; arrays have them on axis 0.

    starts       (P, n) at the beginning of the window
    coordinates  (P, k) their controls (``Controls.coordinates``)
    log_prior    (P,) log density of the first guess, of the coordinates
    log_proposal (P,) log density that importance sampling divides by; zero where they are not weighted by it
    log_kept     (P,) log probability that a candidate was kept whenever candidates were given up; zero before
    fit          (P, S) log likelihood of all readings so far, for each response time and size of the model's error
    predicted    (P, M) their predictions of all readings so far, in the order of the cycles
    now          the candidates at the end of the present cycle, with the model's memory
    """

    starts: Array
    coordinates: Array
    log_prior: Array
    log_proposal: Array
    log_kept: Array
    fit: Array
    predicted: Array
    now: Forecast

    def __len__(self) -> int:
        return len(self.starts)

    def taken(self, indices: IntArray) -> Candidates:
        """Return the candidates of the given indices (M,)."""
        arrays = {one.name: getattr(self, one.name)[indices] for one in fields(self) if one.name != "now"}
        return Candidates(**arrays, now=rows(self.now, indices))

    def joined(self, other: Candidates) -> Candidates:
        """Return these candidates and others after them."""
        arrays = {
            one.name: np.concatenate([getattr(self, one.name), getattr(other, one.name)])
            for one in fields(self)
            if one.name != "now"
        }
        return Candidates(**arrays, now=joined_forecasts(self.now, other.now))

    def to_memory(self) -> dict[str, Any]:
        """Return everything as named arrays."""
        arrays = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "now"}
        arrays |= {"members": self.now.ensemble.members, "time": np.array(self.now.ensemble.time)}
        return arrays | {f"{MODEL}{name}": array for name, array in (self.now.memory or {}).items()}

    @classmethod
    def from_memory(cls, memory: Memory, space: StateSpace) -> Candidates:
        """Return the candidates that ``to_memory`` made arrays of."""
        of_model = {name.removeprefix(MODEL): memory[name] for name in memory if name.startswith(MODEL)}
        now = Forecast(Ensemble(memory["members"], space, float(memory["time"])), of_model or None)
        arrays = {one.name: np.asarray(memory[one.name]) for one in fields(cls) if one.name != "now"}
        return cls(**arrays, now=now)

    def carried_on(self, window: Window, memory: Memory, likelihood: Likelihood) -> Candidates:
        """Return the candidates stepped to the end of the present cycle, with all readings seen.

        ``memory`` has the number of cycles that they have passed, ``done``, and how many readings these had, ``seen``.
        Candidates whose run fails are left out. If these cycles have more readings by now, which came late, or a new
        reading is a mean over some of them, the candidates are run again from the start.
        """
        since = int(memory["done"])
        new = {cycle.number: cycle.observation.operator for cycle in window.cycles if cycle.number >= since}
        if readings_before(window, since) != int(memory["seen"]) or begins(new, window.rerun.dt) < since:
            start = window.first.ensemble.with_members(self.starts)
            now, predicted, kept = _run(window, start, window.cycles[0].number)
            return replace(self.taken(kept), fit=_fit(window, predicted, likelihood), predicted=predicted, now=now)
        now, predicted, kept = _run(window, self.now, since)
        rest = self.taken(kept)
        predicted = np.concatenate([rest.predicted, predicted], axis=1)
        fit = _fit(window, predicted, likelihood, since, rest.fit)
        return replace(rest, fit=fit, predicted=predicted, now=now)


def readings_before(window: Window, number: int) -> int:
    """Return how many readings the cycles of the window before cycle ``number`` have."""
    return sum(cycle.observation.values.size for cycle in window.cycles if cycle.number < number)


def rows(forecast: Forecast, indices: IntArray) -> Forecast:
    """Return the members of the given indices (M,) of a forecast, without weights, with their share of the memory."""
    memory = forecast.memory
    part = None if memory is None else {name: np.asarray(array)[indices] for name, array in memory.items()}
    return Forecast(forecast.ensemble.with_members(forecast.ensemble.members[indices]), part)


def joined_forecasts(one: Forecast, other: Forecast) -> Forecast:
    """Return the members of two forecasts, without weights, with their memory if both have one."""
    memory = None
    if one.memory is not None and other.memory is not None:
        memory = {name: np.concatenate([one.memory[name], other.memory[name]]) for name in one.memory}
    members = np.concatenate([one.ensemble.members, other.ensemble.members])
    return Forecast(one.ensemble.with_members(members), memory)


def first_candidates(window: Window, controls: Controls, likelihood: Likelihood) -> Candidates:
    """Return the belief at the start of the window, carried to the present by re-runs of the model.

    The members are first guesses: raises ContractError if the model calls one of them impossible.
    """
    starts = window.first.ensemble.members
    coordinates = controls.coordinates(starts)
    log_prior = log_prior_of(window, controls, starts, coordinates, drawn=True)
    return evaluated(window, starts, coordinates, log_prior, likelihood, window.first.memory)[0]


def log_prior_of(
    window: Window, controls: Controls, starts: Array, coordinates: Array, *, drawn: bool = False
) -> Array:
    """Return the log density (P,) of the first guess, of the coordinates (P, k) of members ``starts`` (P, n).

    Raises ContractError if the model calls members impossible that it has ``drawn`` itself.
    """
    return window.rerun.log_first_guess(starts, drawn=drawn) + controls.log_volume(coordinates)


def evaluated(
    window: Window,
    starts: Array,
    coordinates: Array,
    log_prior: Array,
    likelihood: Likelihood,
    memory: Memory | None = None,
) -> tuple[Candidates, IntArray]:
    """Run candidates from the start of the window and weigh all readings so far; those whose run fails are left out.

    Return the rest and their indices. ``memory`` is the model's, if it is known; by default the model makes a new one.
    If none is left, raises the model's SolverError or DivergenceError.
    """
    ensemble = window.first.ensemble.with_members(starts)
    start = ensemble if memory is None else Forecast(ensemble, memory)
    now, predicted, kept = _run(window, start, window.cycles[0].number)
    fit = _fit(window, predicted, likelihood)
    zeros = np.zeros(len(kept))
    return Candidates(starts[kept], coordinates[kept], log_prior[kept], zeros, zeros, fit, predicted, now), kept


def tried(
    window: Window, starts: Array, coordinates: Array, log_prior: Array, likelihood: Likelihood
) -> tuple[Candidates, IntArray] | None:
    """Return what ``evaluated`` returns; None if the model can run none of the candidates, or there are none."""
    if not len(starts):
        return None
    try:
        return evaluated(window, starts, coordinates, log_prior, likelihood)
    except (SolverError, DivergenceError) as error:
        if error.member is None:
            raise
        return None  # each of them failed for itself; the candidates so far are not concerned


def _fit(
    window: Window, predicted: Array, likelihood: Likelihood, since: int = 0, before: Array | None = None
) -> Array:
    """Return the log likelihood (P, S) of all readings so far, from the predictions (P, M) of them.

    That ``before`` (P, S) of the readings of the cycles before ``since`` is added to, unless backgrounds or slow
    sensors tie all readings together.
    """
    fit = np.zeros((len(predicted), likelihood.n_cases))
    if likelihood.has_slow_sensors:
        return fit_of_slow_sensors(window, predicted, likelihood) if predicted.shape[1] else fit
    if likelihood.has_background:
        return likelihood.of_sequence(window.cycles, predicted).fit if predicted.shape[1] else fit
    column = readings_before(window, since)
    for cycle in window.cycles:
        seen = cycle.observation
        if cycle.number >= since and seen.values.size:
            columns = slice(column, column + seen.values.size)
            part = predicted[:, columns]
            fit += likelihood.log_density(part, seen.values, seen.covariance, seen.operator.limits)
            column = columns.stop
    return fit if before is None else before + fit


def _run(window: Window, start: Forecast | Ensemble, first: int) -> tuple[Forecast, Array, IntArray]:
    """Run members from cycle ``first`` to now.

    Return the members now, their predictions (P, M), and the indices (P,) of those that did not fail.
    """
    cycles = [cycle for cycle in window.cycles if cycle.number >= first]
    operators = {cycle.number: cycle.observation.operator for cycle in cycles if cycle.observation.values.size}

    def run(kept: IntArray) -> Replay:
        part = start.with_members(start.members[kept]) if isinstance(start, Ensemble) else rows(start, kept)
        return window.rerun(part, first, cycles[-1].number + 1, operators=operators)

    ensemble = start if isinstance(start, Ensemble) else start.ensemble
    replay, kept = without_failures(run, len(ensemble))  # of candidates that cannot be run; they are given no weight
    predicted = [np.empty((len(kept), 0)), *(replay.predicted[number] for number in operators)]
    now = Forecast(replay.forecast.ensemble, replay.forecast.memory)
    return now, np.concatenate(predicted, axis=1), kept


def without_failures(run: Callable[[IntArray], Replay], count: int) -> tuple[Replay, IntArray]:
    """Run ``count`` members without those for which the model fails, and return the re-run and their indices (M,).

    ``run`` runs the members of given indices. If it fails for all, raises the model's SolverError or DivergenceError.
    """
    kept: IntArray = np.arange(count)
    while True:
        try:
            return run(kept), kept
        except (SolverError, DivergenceError) as error:
            if error.member is None or len(kept) == 1:
                raise
            kept = np.delete(kept, error.member)
