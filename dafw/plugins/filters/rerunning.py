"""What filters have in common that move control variables at the start and run the model again: ``Rerunning``.

**Two ways to use the readings.** If the window reaches back to the release, every analysis starts from the first guess
and uses all readings (nothing is used twice, because the first guess knows none of them). With a window of a fixed
number of cycles, an analysis starts from the belief at the beginning of the window, which knows all earlier readings,
and uses the new ones only. The beliefs within the window are then revised, so that the next window begins with what is
known by now. Bocquet and Sakov (2014), doi:10.1002/qj.2236, call this single data assimilation; ``every`` is the
shift S of their windows, and ``window`` their length L.

**Coordinates.** Controls move as plain numbers, in the logarithm if they are positive, or single and nonnegative: so
none is caught at zero, where a linear update would put a wind speed again and again. Angles are taken modulo 2 pi.

**Members that cannot be run.** If the model fails for a member that was moved, the member's move is halved and the run
repeated. After ``HALVINGS`` halvings the member goes back to where it was before. If the model fails for it there, too
(a member of the first guess may fail at a later time than it ever reached), it goes half of the way to the mean of the
members, and so on; after as many halvings, to the mean. If that fails, the error ends the study. An error that names no
member is taken to be about all of them.

**Model error.** A re-run has the random numbers of the belief's own steps, so a model with drawn noise is a fixed but
different function for each member. These filters take the members' differences for the effect of the controls; they
are made for models without drawn noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from dafw.core.covariances import whiten
from dafw.core.ensemble import Analysis, Diagnostic, Forecast, Memory
from dafw.core.errors import ConfigurationError, DivergenceError, SolverError
from dafw.core.interfaces import Filter
from dafw.core.options import option
from dafw.core.rerun import Replay
from dafw.core.space import Array, IntArray, StateSpace
from dafw.core.window import Window
from dafw.plugins.filters.compared import Compared, Comparison, compared, counted, recalled, remembered
from dafw.plugins.filters.controls import Controls
from dafw.plugins.filters.waiting import marked, unmarked, waits

HALVINGS = 4
LAST_TRY = 2 * HALVINGS + 2


@dataclass(frozen=True, eq=False)
class Run:
    """A re-run of moved members.

    ``start`` is the ensemble at the beginning of the window. ``tries`` (N,) counts how often the model failed for each
    member before (see ``reached``). ``anomalies`` (N, M) and ``innovation`` (M,) are the predictions less their mean,
    and the readings less this mean; ``missed`` (N, M) are the readings less the predictions. All three are in units of
    the readings' errors (whitened).
    """

    start: Forecast
    replay: Replay
    tries: IntArray
    anomalies: Array
    innovation: Array

    @property
    def missed(self) -> Array:
        """The readings less each member's predictions (N, M)."""
        return self.innovation - self.anomalies

    @property
    def mismatch(self) -> float:
        """Mean square of the innovation in units of the readings' errors: about 1 where all is explained."""
        return float(np.mean(self.innovation**2))


def reached(before: Array, after: Array, tries: IntArray) -> Array:
    """Return where members (N, k) are placed that should go from ``before`` to ``after``, after so many failed tries.

    They go all the way, half of it, ..., not at all; half of the way from ``before`` to the mean, ..., to the mean.
    """
    forward = np.where(tries <= HALVINGS, 0.5**tries, 0.0)[:, np.newaxis]
    back = np.where(tries < LAST_TRY, 1.0 - 0.5 ** np.maximum(tries - HALVINGS - 1.0, 0.0), 1.0)[:, np.newaxis]
    retreated = before + forward * (after - before) + back * (before.mean(axis=0) - before)
    return np.where(tries[:, np.newaxis] == 0, after, retreated)


@dataclass
class Rerunning(Filter):
    """Options, windows and re-runs; a filter defines ``moved_start``."""

    past_beliefs = "first"
    inflation_option: ClassVar[str | None] = None

    estimate: list[str] = option([], "names of the control variables; none: all of size 1, else the whole state")
    every: int = option(1, "cycles from one analysis to the next; in between the forecast is kept", minimum=1)
    transform: str = option("none", "compare readings as they are, or log(reading + floor)", choices=("none", "log"))
    floor: float = option(1e-3, "c0 of the logarithm, in units of the readings", above=0.0)
    model_error: float = option(0.0, "what the model cannot explain: standard deviation of a reading", minimum=0.0)
    relative_model_error: float = option(0.0, "the same as a fraction of the reading", minimum=0.0)
    inflation: float = option(
        1.0, "factor on the controls' anomalies at the beginning of the window before an analysis", minimum=1.0
    )

    @property
    def uses_new_only(self) -> bool:
        """Whether an analysis uses the new readings only and revises the past."""
        return self.window is not None

    def suit(self, space: StateSpace, n_members: int) -> None:
        """Raise ConfigurationError for names that are not variables, or readings that no analysis would use."""
        try:
            Controls(space, self.estimate)
        except ConfigurationError as error:
            raise ConfigurationError(f"{self.label}: {error}") from error
        if self.window is not None and self.every > self.window:
            raise ConfigurationError(
                f"{self.label}: every must be at most window, so that each reading is used once; "
                f"got every={self.every} and window={self.window}"
            )

    def moved_start(self, work: Work, rng: np.random.Generator) -> Run:
        """Return the last re-run of an analysis, whose members at its end are the belief."""
        raise NotImplementedError(f"{self.label} must define moved_start(work, rng)")

    def unfinished(self, memory: Memory | None) -> bool:
        """Return whether readings wait for the next analysis."""
        return waits(memory)

    def analyse_window(self, window: Window, rng: np.random.Generator) -> Analysis:
        """Return the analysis if one is due, otherwise the forecast."""
        if window.first.ensemble.weights is not None or window.forecast.ensemble.weights is not None:
            raise ConfigurationError(f"{self.label}: expected members that count equally, got members with weights")
        readings, space = counted(window), window.forecast.ensemble.space
        known = unmarked(window.memory)
        used = recalled(known, "used") if self.uses_new_only else {}
        before = recalled(known, "readings")
        missed = sum(before[cycle] - used.get(cycle, 0) for cycle in before if cycle not in readings)
        seen = {"readings_missed": Diagnostic(missed, long_name="readings that left the window unused")}
        if not self._due(window, readings, used):
            members = space.retract(window.forecast.ensemble.members, np.zeros(space.size))
            return Analysis(members, marked(self._memory(readings, used), window), seen)
        comparison = Comparison(self.transform == "log", self.floor, self.model_error, self.relative_model_error)
        work = Work(self, window, compared(window, comparison, used))
        run = self.moved_start(work, rng)
        seen |= {
            "readings_used": Diagnostic(work.readings.values.size, long_name="readings that the analysis used"),
            "model_runs": Diagnostic(work.runs, long_name="re-runs of the whole ensemble"),
            "runs_failed": Diagnostic(work.failures, long_name="how often the model failed for a member of a re-run"),
            "mismatch": Diagnostic(
                run.mismatch, long_name="mean square of what the analysis leaves unexplained, over the readings' errors"
            ),
        }
        return self._concluded(window, run, self._memory(readings, readings), seen)

    def _due(self, window: Window, readings: Mapping[int, int], used: Mapping[int, int]) -> bool:
        """Return whether it is time for an analysis, or a reading would leave the window before the next."""
        if (window.cycles[-1].number + 1) % self.every == 0:
            return True
        first = window.cycles[0].number
        return len(window.cycles) == self.window and readings[first] > used.get(first, 0)

    def _memory(self, readings: Mapping[int, int], used: Mapping[int, int]) -> Memory | None:
        return remembered(readings, used) if self.uses_new_only else None

    def _concluded(
        self, window: Window, run: Run, memory: Mapping[str, Array] | None, diagnostics: Mapping[str, Diagnostic]
    ) -> Analysis:
        """Return the analysis with the members at the end of the last run, every variable in its range."""
        space, end = window.forecast.ensemble.space, run.replay.forecast
        still = np.zeros(space.size)
        revised: dict[int, Forecast] = {}
        if self.uses_new_only:
            beliefs = [run.start, *run.replay.states[:-1]]
            for cycle, belief in zip(window.cycles, beliefs, strict=True):
                revised[cycle.number] = belief.with_members(space.retract(belief.ensemble.members, still))
        members = space.retract(end.ensemble.members, still)
        return Analysis(members, memory, diagnostics, revised=revised, model_memory=end.memory)


class Work:
    """What one analysis works with: the readings, the control variables in coordinates, and re-runs.

    Attributes:
        readings: those that the analysis uses, as they are compared.
        controls: the control variables.
        first: the members (N, n) at the beginning of the window.
        inflation: the factor on the controls' anomalies.
        runs, failures: how many re-runs of the ensemble were made, and how often one failed for a member.
    """

    def __init__(self, filter_: Rerunning, window: Window, readings: Compared) -> None:
        self.readings, self.first, self.inflation = readings, window.first.ensemble.members, filter_.inflation
        self.controls = Controls(window.first.ensemble.space, filter_.estimate)
        self.runs = self.failures = 0
        self._window, self._keep = window, filter_.uses_new_only
        self._at_start = window.cycles[0].number == 0
        self._settle = self._at_start and not self.controls.has_fields

    def placed(self, coordinates: Array) -> Array:
        """Return the members (N, n) at the beginning of the window with their controls at ``coordinates`` (N, k)."""
        return self.controls.at(self._window.rerun, self.first, coordinates, settle=self._settle)

    def differ_in_controls_alone(self, centre: Array) -> bool:
        """Return whether all members are the same if their controls are at ``centre`` (k,)."""
        if not self._at_start and self._window.first.memory is not None:
            return False
        same = self.placed(np.tile(centre, (len(self.first), 1)))
        return bool((same == same[0]).all())

    def spread(self, members: Array) -> tuple[Array, Array]:
        """Return the mean (k,) of the members' controls in coordinates, and the anomalies (N, k) around it."""
        middle = self.controls.coordinates(self.controls.space.mean(members)[np.newaxis])[0]
        anomalies = self.controls.offset(self.controls.coordinates(members), middle)
        # The circular mean of angles, and the logarithm of a mean, are not quite the mean in coordinates.
        shift = anomalies.mean(axis=0)
        return middle + shift, anomalies - shift

    def run(self, coordinates: Array, before: Array, *, last: bool = False) -> Run:
        """Run members with their controls at ``coordinates`` (N, k) from the beginning of the window to now.

        Members for which the model fails are placed nearer to ``before`` (N, k), or to the mean of ``before``.
        ``last``: this is the last run of the analysis. Raises the model's error if it fails at the mean, too.
        """
        window, tries = self._window, np.zeros(len(coordinates), dtype=np.int64)
        stays = (coordinates == before).all(axis=1)
        first, end = window.cycles[0].number, window.cycles[-1].number + 1
        while True:
            moved = window.first.ensemble.with_members(self.placed(reached(before, coordinates, tries)))
            # The model makes the memory of members at its start; in the middle of a study they have theirs already.
            start = window.rerun.with_memory(moved) if self._at_start else replace(window.first, ensemble=moved)
            self.runs += 1
            try:
                replay = window.rerun(start, first, end, operators=self.readings.operators, keep=last and self._keep)
                break
            except (SolverError, DivergenceError) as error:
                failed = np.arange(len(tries)) if error.member is None else np.array([error.member])
                if (tries[failed] == LAST_TRY).all():
                    raise
                # A member that was not to move is not tried again at the same place.
                tries[failed] = np.where(stays[failed], np.maximum(tries[failed], HALVINGS + 1), tries[failed]) + 1
                tries = np.minimum(tries, LAST_TRY)
                self.failures += len(failed)
        predicted = self.readings.predicted(replay)
        mean = predicted.mean(axis=0)
        rows = whiten(self.readings.covariance, np.vstack([predicted - mean, self.readings.values - mean]))
        return Run(start, replay, tries, rows[:-1], rows[-1])
