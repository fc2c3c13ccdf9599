"""Writes the cycles of a run to ``run.nc`` while the run goes on. docs/run-file.md lists the names in the file.

Row k of ``time`` is the state after k cycles, as it was known then. Fields are stored in single precision, parameters
and scores in double. Rows are held in memory until one comes at least ``FLUSH_SECONDS`` after the last write. Then all
are written and the file is synchronised, so that a run killed at any moment leaves a file that opens. Beliefs that a
filter revises later are written at the same time, to the row that they belong to, as separate variables.

A study of many runs may keep the fields of the first and the last row only (``fields="ends"``): of a hundred rows this
leaves a fiftieth. The others hold missing values, for which the file needs no space.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from dafw.core.cycle import PHASES, Cycle, Parts, State
from dafw.core.diagnostics import INNOVATION, SCORES, error_of, innovation_scores, scores
from dafw.core.ensemble import Ensemble
from dafw.core.observation import Observation, Selection
from dafw.core.run_file import RunFile
from dafw.core.space import Array, StateSpace

FLUSH_SECONDS = 0.5


class Record:
    """Writes one run. ``with_members`` names the state variables of which every member is kept.

    ``fields`` says in which rows state variables with several numbers are kept: ``all``, or the ``ends``.
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
    ) -> None:
        self._space, self._with_members = parts.model.space, tuple(with_members)
        self._has_truth, self._smooths = parts.truth is not None, parts.filter.window != 0
        self._file = RunFile(
            path,
            parts,
            n_members=len(state.belief.ensemble),
            n_vehicles=len(state.vehicle.positions),
            with_members=self._with_members,
            section=section,
            attributes=attributes,
        )
        self._rows: list[dict[str, Any]] = []
        self._revised: dict[int, Ensemble] = {}
        self._thin = fields == "ends"
        self._done = 0
        self._last_fields: dict[str, Any] = {}
        self._truths: dict[int, Array] = {}
        self._flushed = perf_counter()
        self._recording = 0.0
        self._append(state, parts.seen(state.truth), None)
        self.flush()

    def append(self, cycle: Cycle) -> dict[str, float]:
        """Add a finished cycle; return its scores."""
        begun = perf_counter()
        row = self._append(cycle.state, cycle.truth, cycle)
        self._revised.update({done: belief.ensemble for done, belief in cycle.analysis.revised.items()})
        if perf_counter() - self._flushed > FLUSH_SECONDS:
            self.flush()
        self._recording = perf_counter() - begun
        return {name: row[name] for name in (*SCORES, *INNOVATION) if name in row}

    def _append(self, state: State, truth: Ensemble | None, cycle: Cycle | None) -> dict[str, Any]:
        belief = state.belief.ensemble
        free = state.free.ensemble if state.free else None
        forecast = cycle.forecast if cycle else None
        stages: dict[str, Array | None] = {
            "truth": truth.members[0] if truth else None,
            "free": free.members[0] if free else None,
            "forecast_mean": forecast.mean if forecast else None,
            "forecast_spread": forecast.spread if forecast else None,
            "mean": belief.mean,
            "spread": belief.spread,
        }
        if self._smooths:
            stages |= {"smoothed_mean": belief.mean, "smoothed_spread": belief.spread}
        row: dict[str, Any] = {}
        for stage, vector in stages.items():
            row |= self._unpacked(vector, stage) if vector is not None else {}
        for name in self._with_members:
            row[f"{name}_members"] = _squeeze(belief.members[:, self._space.slice(name)])
        if belief.weights is not None:
            self._file.require_weights()
            row["weight"] = belief.weights
        row["time"] = belief.time
        row["vehicle_x"], row["vehicle_y"] = state.vehicle.positions.T
        found = scores(self._space, truth.members[0] if truth else None, belief, forecast, free)
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
            self._truths[self._done] = truth.members[0, scored].astype(np.float32)
        if self._done:
            names = [name for name in row if self._file.is_field(name)]
            self._last_fields = {name: row.pop(name) for name in names}

    def _unpacked(self, vector: Array, stage: str) -> dict[str, Array]:
        """Return a state (n,) as the row's variables of a stage."""
        return {f"{name}_{stage}": _squeeze(values) for name, values in self._space.unpack(vector).items()}

    def _cycle_row(self, cycle: Cycle) -> dict[str, Any]:
        # The time that recording takes is known only afterwards, so it is recorded in the next row.
        seconds = cycle.seconds | {"record": self._recording}
        row: dict[str, Any] = {"phase_seconds": [seconds.get(phase, np.nan) for phase in PHASES]}
        expected = cycle.forecast.average(cycle.predicted)
        row |= _observation_row(cycle, expected, self._space)
        row |= innovation_scores(cycle.observation, cycle.forecast, cycle.predicted, expected)
        for kind, diagnostics in cycle.diagnostics.items():
            for name, diagnostic in diagnostics.items():
                row[f"{kind}_{name}"] = values = np.asarray(diagnostic.values)
                self._file.require(f"{kind}_{name}", diagnostic, values)
        return row

    def flush(self) -> None:
        """Write the rows held in memory, and revised beliefs to the rows that they belong to; synchronise the file."""
        self._file.write(self._rows)
        self._rows.clear()
        for done, belief in self._revised.items():
            row: dict[str, Any] = self._unpacked(belief.mean, "smoothed_mean") | self._unpacked(
                belief.spread, "smoothed_spread"
            )
            if self._has_truth:
                row["err_smoothed"] = self._smoothed_error(done, belief)
            if self._thin and done:
                row = {name: values for name, values in row.items() if not self._file.is_field(name)}
            self._file.rewrite(done, row)
        if self._revised:
            self._revised.clear()
            self._file.write([])
        self._flushed = perf_counter()

    def _smoothed_error(self, done: int, belief: Ensemble) -> float:
        """Return ERR of a revised belief against the truth as the file has it, in single precision."""
        name = self._space.variables[0].name
        part = self._space.slice(name)
        truth: Array = np.full(self._space.size, np.nan)
        truth[part] = self._truths[done] if self._thin else self._file.read(f"{name}_truth", done)
        return error_of(self._space, truth, belief.mean)

    def close(self) -> None:
        """Write the remaining rows and close the file. It is closed even if they cannot be written."""
        if self._file.is_open:
            try:
                self.flush()
                if self._last_fields:
                    self._file.rewrite(self._done, self._last_fields)
            finally:
                self._file.close()


def _observation_row(cycle: Cycle, expected: Array, space: StateSpace) -> dict[str, Any]:
    """Return the readings that arrived in a cycle: those used now, late ones, and dropped ones.

    ``expected`` (m,) is what the forecast predicts for those used now.
    """
    readings = cycle.readings
    # The filter uses these readings together at the end of the cycle, but each was taken at its own time.
    row = _readings(readings.now, 0, expected, space) | {"observation_time": readings.times}
    others = [(one, 1) for _, one in readings.late] + [(one, 2) for one in readings.dropped]
    if not others:
        return row
    unknown = [np.full(one.values.size, np.nan) for one, _ in others]
    rows = [row, *(_readings(one, use, x, space) for (one, use), x in zip(others, unknown, strict=True))]
    missing = {"observation_node": -1, "observation_x": np.nan, "observation_y": np.nan}
    names = dict.fromkeys(name for one in rows for name in one)
    return {
        name: np.concatenate(
            [one.get(name, np.full(one["observation_value"].size, missing.get(name, np.nan))) for one in rows]
        )
        for name in names
    }


def _readings(observation: Observation, use: int, expected: Array, space: StateSpace) -> dict[str, Any]:
    """Return the row's variables of an observation; ``use`` says how it was used."""
    operator, covariance, size = observation.operator, observation.covariance, observation.values.size
    row: dict[str, Any] = {
        "observation_value": observation.values,
        "observation_forecast_mean": expected,
        "observation_variance": covariance if covariance.ndim == 1 else np.diag(covariance),
        "observation_time": np.full(size, observation.time),
        "observation_use": np.full(size, use, dtype="i1"),
    }
    if isinstance(operator, Selection):
        row["observation_node"] = np.where(operator.indices < space.variables[0].size, operator.indices, -1)
    if operator.coordinates is not None:
        for axis, column in zip("xy", operator.coordinates.T, strict=False):
            row[f"observation_{axis}"] = column
    return row


def _squeeze(values: Array) -> Array:
    """Return the values of a variable of size 1 without their last axis."""
    return values[..., 0] if values.shape[-1] == 1 else values
