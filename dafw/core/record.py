"""Writes the cycles of a run to ``run.nc`` while the run goes on. docs/run-file.md lists the names in the file.

Row k of ``time`` is the state after k cycles, as it was known then. Fields are stored in single precision, parameters
and scores in double. Rows are held in memory until one comes at least ``FLUSH_SECONDS`` after the last write, or they
take ``HELD_BYTES``: so memory does not grow with the cycles, however large an ensemble is. Then all
are written and the file is synchronised, so that a run killed at any moment leaves a file that opens. Beliefs that a
filter revises later are written at the same time, to the row that they belong to, as separate variables.

A study of many runs may keep the fields of the first and the last row only (``fields="ends"``): of a hundred rows this
leaves a fiftieth. The others hold missing values, for which the file needs no space.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from dafw.core.checkpoints.journal import Journal
from dafw.core.cycle import PHASES, Cycle, Parts, State
from dafw.core.diagnostics import INNOVATION, SCORES, error_of, innovation_scores, predicted_spread, scores
from dafw.core.ensemble import Ensemble
from dafw.core.errors import CheckpointError
from dafw.core.files import made_anew
from dafw.core.observation import Observation, Selection
from dafw.core.ranks import Ranking
from dafw.core.run_file import RunFile
from dafw.core.run_layout import STAGES
from dafw.core.space import Array, IntArray, StateSpace, Variable

FLUSH_SECONDS = 0.5
HELD_BYTES = 32_000_000
LAST = "last/"
"""Prefix, among what a checkpoint must hold, of the fields that are written only if no further row follows."""
type Entries = Iterable[tuple[dict[str, Any], dict[str, Array]]]
type Numbers = Callable[[Sequence[str]], IntArray]


class Record:
    """Writes one run. ``with_members`` names the state variables of which every member is kept.

    ``fields`` says in which rows state variables with several numbers are kept: ``all``, or the ``ends``. ``state`` is
    that at the start. A ``journal`` is told of everything that is written. ``before`` are the entries of a journal,
    and what ``settle`` returned then: the file is made anew from them and takes its place at the end.
    """

    def __init__(
        self,
        path: Path,
        parts: Parts,
        state: State,
        *,
        with_members: Sequence[str],
        section: Array,
        attributes: Mapping[str, str | int],
        fields: str = "all",
        journal: Journal | None = None,
        before: tuple[Entries, Mapping[str, Array]] | None = None,
    ) -> None:
        self._space = parts.model.space
        self._has_truth, self._smooths = parts.truth is not None, parts.filter.window != 0
        # The variables of the file by stage, and where their values are in a state. A single number is read as one.
        places = {one.name: _place(self._space, one) for one in self._space.variables}
        self._places = {stage: [(f"{name}_{stage}", place) for name, place in places.items()] for stage in STAGES}
        self._places["members"] = [(f"{name}_members", places[name]) for name in with_members]
        beside = path if before is None else made_anew(path)
        self._journal, self._window = journal, parts.filter.window
        self._file = RunFile(
            beside,
            parts,
            n_members=len(state.belief.ensemble),
            n_vehicles=len(state.vehicle.positions),
            with_members=with_members,
            section=section,
            attributes=attributes,
            journal=journal if before is None else None,
        )
        self._rows: list[dict[str, Any]] = []
        self._ranking = Ranking()
        self._row_bytes = self._most = 0
        # Revised beliefs that wait to be written: those that may be revised once more, which the filter's past holds in
        # any case, and mean and spread (n,) of those that may not.
        self._revised: dict[int, Ensemble] = {}
        self._final: dict[int, tuple[Array, Array]] = {}
        self._final_bytes = 2 * state.belief.ensemble.mean.nbytes
        self._thin = fields == "ends"
        self._done = 0
        self._last_fields: dict[str, Any] = {}
        self._truths: dict[int, Any] = {}
        self._flushed = perf_counter()
        self._recording = 0.0
        if before is None:
            self._append(state, parts.seen(state.truth), None)
            self.flush()
        else:
            self._repeat(*before)
            beside.replace(path)

    def append(self, cycle: Cycle) -> dict[str, float]:
        """Add a finished cycle; return its scores."""
        begun = perf_counter()
        row = self._append(cycle.state, cycle.truth, cycle)
        if self._smooths:
            self._revise(cycle)
        # Rows with as many readings are equally large; to add up every row takes 2 % of a small cycle.
        if len(self._rows) == 1 or cycle.observation.values.size > self._most:
            self._most = cycle.observation.values.size
            self._row_bytes = sum(value.nbytes for value in row.values() if isinstance(value, np.ndarray))
        held = len(self._rows) * self._row_bytes + len(self._final) * self._final_bytes
        if perf_counter() - self._flushed > FLUSH_SECONDS or held > HELD_BYTES:
            self.flush()
        self._recording = perf_counter() - begun
        return {name: row[name] for name in (*SCORES, *INNOVATION) if name in row}

    def _revise(self, cycle: Cycle) -> None:
        """Keep the revised beliefs of a cycle until they are written, whole ensembles only while the filter does."""
        for done, revised in cycle.analysis.revised.items():
            self._revised[done] = revised.ensemble
        first = self._may_be_revised
        for done in [done for done in self._revised if done < first]:
            belief = self._revised.pop(done)
            self._final[done] = belief.mean, belief.spread

    def _append(self, state: State, truth: Ensemble | None, cycle: Cycle | None) -> dict[str, Any]:
        belief = state.belief.ensemble
        free = None if state.free is None else state.free.ensemble
        forecast = None if cycle is None else cycle.forecast
        stages = {"mean": belief.mean, "spread": belief.spread}
        if truth is not None:
            stages["truth"] = truth.members[0]
        if free is not None:
            stages["free"] = free.members[0]
        if forecast is not None:
            stages |= {"forecast_mean": forecast.mean, "forecast_spread": forecast.spread}
        if self._smooths:
            stages |= {"smoothed_mean": belief.mean, "smoothed_spread": belief.spread}
        row: dict[str, Any] = {}
        for stage, vector in stages.items():
            for name, place in self._places[stage]:
                row[name] = vector[place]
        for name, place in self._places["members"]:
            # A view of one column would keep all members alive for as long as the row waits.
            row[name] = belief.members[:, place].copy() if isinstance(place, int) else belief.members[:, place]
        if belief.weights is not None:
            self._file.require_weights()
            row["weight"] = belief.weights
        row["time"] = belief.time
        row["vehicle_x"], row["vehicle_y"] = state.vehicle.positions.T
        found = scores(self._space, stages.get("truth"), belief, forecast, free)
        if not self._has_truth:
            found = {"spread": found["spread"]}
        elif free is None:
            del found["err_free"]
        row |= found
        if self._smooths and self._has_truth:
            row["err_smoothed"] = found["err"]
        if cycle is not None:
            row |= self._cycle_row(cycle)
            self._done += 1
        if self._thin:
            self._keep_back(row, truth)
        self._rows.append(row)
        return row

    def _keep_back(self, row: dict[str, Any], truth: Ensemble | None) -> None:
        """Take the fields out of a row that is not the first; ``close`` writes those of the last row."""
        if self._smooths and truth is not None:  # revisions are compared with it, and the file will not have it
            scored = self._space.slice(self._space.variables[0].name)
            kept = truth.members[0, scored].astype(np.float32)
            self._truths[self._done] = kept
            if self._journal is not None:
                self._journal.add({"truth": self._done}, {"truth": kept})
        if self._done:
            names = [name for name in row if self._file.is_field(name)]
            self._last_fields = {name: row.pop(name) for name in names}

    def _cycle_row(self, cycle: Cycle) -> dict[str, Any]:
        # The time that recording takes is known only afterwards, so it is recorded in the next row.
        seconds = cycle.seconds | {"record": self._recording}
        row: dict[str, Any] = {"phase_seconds": [seconds.get(phase, np.nan) for phase in PHASES]}
        expected = cycle.forecast.average(cycle.predicted)
        spread = predicted_spread(cycle.forecast, cycle.predicted, expected)
        told = {
            "observation_forecast_mean": expected,
            "observation_forecast_spread": spread,
            "observation_rank": np.full(cycle.observation.values.size, np.nan),
        }
        row |= _observation_row(cycle, told, self._space, self._file.sensor_numbers)
        self._ranking.add(row["observation_rank"], cycle.observation, cycle.forecast, cycle.predicted)
        if "observation_span" in row:
            self._file.require_spans()
        row |= innovation_scores(cycle.observation, expected, spread)
        for kind, diagnostics in cycle.diagnostics.items():
            for name, diagnostic in diagnostics.items():
                row[f"{kind}_{name}"] = values = np.asarray(diagnostic.values)
                self._file.require(f"{kind}_{name}", diagnostic, values)
        return row

    def flush(self) -> None:
        """Write the rows held in memory, and revised beliefs to the rows that they belong to; synchronise the file."""
        self._ranking.settle()
        self._file.write(self._rows)
        self._rows.clear()
        revised = self._final | {done: (belief.mean, belief.spread) for done, belief in self._revised.items()}
        for done, (mean, spread) in revised.items():
            row: dict[str, Any] = {name: mean[place] for name, place in self._places["smoothed_mean"]}
            row |= {name: spread[place] for name, place in self._places["smoothed_spread"]}
            if self._has_truth:
                row["err_smoothed"] = self._smoothed_error(done, mean)
            if self._thin and done:
                row = {name: values for name, values in row.items() if not self._file.is_field(name)}
            self._file.rewrite(done, row)
        if revised:
            self._revised.clear()
            self._final.clear()
            self._file.write([])
        self._drop_truths()
        self._flushed = perf_counter()

    def settle(self) -> dict[str, Array]:
        """Write everything, and return what a checkpoint must hold.

        This is the revisions of rows that may be revised again, and the fields of the last row if only those of the
        ends are kept.
        """
        self.flush()
        last = {f"{LAST}{name}": self._file.as_stored(name, values) for name, values in self._last_fields.items()}
        return self._file.settle(self._may_be_revised) | last

    def _drop_truths(self) -> None:
        """Forget the truth of rows that the filter may not revise any more; the oldest come first."""
        while self._truths and next(iter(self._truths)) < self._may_be_revised:
            del self._truths[next(iter(self._truths))]

    @property
    def _may_be_revised(self) -> int:
        """The first row that the filter may still revise."""
        return 0 if self._window is None else self._done + 1 - self._window

    def _repeat(self, entries: Entries, later: Mapping[str, Array]) -> None:
        """Write what a journal and a checkpoint have; raises CheckpointError if the file does not fit."""
        try:
            for told, arrays in entries:
                if "truth" in told:
                    self._done = int(told["truth"])
                    self._truths[self._done] = arrays["truth"]
                    self._drop_truths()
                else:
                    self._file.repeat(told, arrays)
            self._last_fields = {name.removeprefix(LAST): later[name] for name in later if name.startswith(LAST)}
            revised = {name: values for name, values in later.items() if not name.startswith(LAST)}
            self._done = self._file.go_on(self._journal, revised) - 1
        except (LookupError, TypeError, ValueError) as error:
            raise CheckpointError(f"its rows do not fit the study ({type(error).__name__}: {error})") from error

    def _smoothed_error(self, done: int, mean: Array) -> float:
        """Return ERR of a revised belief's mean (n,) against the truth as the file has it, in single precision."""
        name = self._space.variables[0].name
        part = self._space.slice(name)
        truth: Array = np.full(self._space.size, np.nan)
        truth[part] = self._truths[done] if self._thin else self._file.read(f"{name}_truth", done)
        return error_of(self._space, truth, mean)

    def close(self) -> None:
        """Write the remaining rows and close the file. It is closed even if they cannot be written."""
        if self._file.is_open:
            try:
                self.flush()
                if self._last_fields:
                    self._file.rewrite(self._done, self._last_fields)
            finally:
                self._file.close()


def _observation_row(cycle: Cycle, told: Mapping[str, Array], space: StateSpace, numbers: Numbers) -> dict[str, Any]:
    """Return the readings that arrived in a cycle: those used now, late ones, and dropped ones.

    ``told`` has by name what the forecast says (m,) of those used now; it says nothing of the others. ``numbers``
    returns the numbers of sensors.
    """
    readings = cycle.readings
    # The filter uses these readings together at the end of the cycle, but each was taken at its own time.
    row = _readings(readings.now, np.zeros(readings.times.size, dtype="i1"), readings.times, space, numbers)
    row |= told
    others = [(one, 1) for _, one in readings.late] + [(one, 2) for one in readings.dropped]
    if not others:
        return row
    rows = [row]
    for one, use in others:
        size = one.values.size
        uses, times = np.full(size, use, dtype="i1"), np.full(size, one.time)
        rows.append(_readings(one, uses, times, space, numbers))
    missing = {"observation_node": -1, "observation_sensor": -1, "observation_x": np.nan, "observation_y": np.nan}
    names = dict.fromkeys(name for one in rows for name in one)
    return {
        name: np.concatenate(
            [one.get(name, np.full(one["observation_value"].size, missing.get(name, np.nan))) for one in rows]
        )
        for name in names
    }


def _readings(observation: Observation, uses: Any, times: Array, space: StateSpace, numbers: Numbers) -> dict[str, Any]:
    """Return the row's variables of readings taken at ``times`` (m,); ``uses`` (m,) say how they were used."""
    operator = observation.operator
    row: dict[str, Any] = {
        "observation_value": observation.values,
        "observation_variance": observation.variance,
        "observation_time": times,
        "observation_use": uses,
    }
    if isinstance(operator, Selection):
        n_nodes, indices = space.variables[0].size, operator.indices
        row["observation_node"] = indices if n_nodes == space.size else np.where(indices < n_nodes, indices, -1)
    if operator.spans is not None:
        row["observation_span"] = operator.spans
    if operator.sensors:
        row["observation_sensor"] = numbers(operator.sensors)
    if operator.coordinates is not None:
        for axis, column in zip("xy", operator.coordinates.T, strict=False):
            row[f"observation_{axis}"] = column
    return row


def _place(space: StateSpace, variable: Variable) -> slice | int:
    """Return where a variable's values are in a state; the entry alone if there is only one."""
    part = space.slice(variable.name)
    return part if variable.size > 1 else part.start
