"""What a run keeps of its cycles, written while it goes on and read by plain xarray. docs/run-file.md lists the names.

Row k of ``time`` is the state after k cycles. Fields are stored in single precision, parameters and scores in double.
Rows are kept back until one comes ``FLUSH_SECONDS`` after the last writing, and then written and synchronised; a run
killed at any moment leaves a file that opens.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from dafw.core.cycle import PHASES, Cycle, Parts, State
from dafw.core.diagnostics import SCORES, scores
from dafw.core.run_file import RunFile
from dafw.core.space import Array

FLUSH_SECONDS = 0.5


class Record:
    """Writes one run. ``whole`` names the state variables of which every member is kept."""

    def __init__(
        self,
        path: Path,
        parts: Parts,
        state: State,
        *,
        whole: Sequence[str],
        section: Array,
        attributes: Mapping[str, str | int],
    ) -> None:
        self._space, self._whole = parts.model.space, tuple(whole)
        self._file = RunFile(
            path,
            parts,
            n_members=len(state.belief.ensemble),
            n_vehicles=len(state.vehicle.positions),
            whole=self._whole,
            section=section,
            attributes=attributes,
        )
        self._rows: list[dict[str, Any]] = []
        self._flushed = perf_counter()
        self._recording = 0.0
        self._append(state, None, {})
        self.flush()

    def append(self, cycle: Cycle) -> dict[str, float]:
        """Add a finished cycle; return its scores."""
        begun = perf_counter()
        row = self._append(cycle.state, cycle, {})
        if perf_counter() - self._flushed > FLUSH_SECONDS:
            self.flush()
        self._recording = perf_counter() - begun
        return {name: row[name] for name in SCORES}

    def _append(self, state: State, cycle: Cycle | None, row: dict[str, Any]) -> dict[str, Any]:
        belief, truth = state.belief.ensemble, state.truth.ensemble
        free = state.free.ensemble if state.free else None
        forecast = cycle.forecast if cycle else None
        stages: dict[str, Array | None] = {
            "truth": truth.members[0],
            "free": free.members[0] if free else None,
            "forecast_mean": forecast.mean if forecast else None,
            "forecast_spread": forecast.spread if forecast else None,
            "mean": belief.mean,
            "spread": belief.spread,
        }
        for stage, vector in stages.items():
            if vector is not None:
                for name, values in self._space.unpack(vector).items():
                    row[f"{name}_{stage}"] = _squeeze(values)
        for name in self._whole:
            row[f"{name}_members"] = _squeeze(belief.members[:, self._space.slice(name)])
        row["time"] = belief.time
        row["vehicle_x"], row["vehicle_y"] = state.vehicle.positions.T
        row |= scores(self._space, truth.members[0], belief, forecast, free)
        if cycle is not None:
            row |= self._cycle_row(cycle)
        self._rows.append(row)
        return row

    def _cycle_row(self, cycle: Cycle) -> dict[str, Any]:
        operator = cycle.observation.operator
        covariance = cycle.observation.covariance
        # How long recording took is known when it is done: the row after it says so.
        seconds = cycle.seconds | {"record": self._recording}
        row: dict[str, Any] = {
            "observation_value": cycle.observation.values,
            "observation_forecast_mean": cycle.predicted.mean(axis=0),
            "observation_variance": covariance if covariance.ndim == 1 else np.diag(covariance),
            "phase_seconds": [seconds.get(phase, np.nan) for phase in PHASES],
        }
        if (indices := getattr(operator, "indices", None)) is not None:
            row["observation_node"] = np.where(indices < self._space.variables[0].size, indices, -1)
        if operator.coordinates is not None:
            for axis, column in zip("xy", operator.coordinates.T, strict=False):
                row[f"observation_{axis}"] = column
        for kind, diagnostics in cycle.diagnostics.items():
            for name, diagnostic in diagnostics.items():
                row[f"{kind}_{name}"] = values = np.asarray(diagnostic.values)
                self._file.require(f"{kind}_{name}", diagnostic, values)
        return row

    def flush(self) -> None:
        """Write what is kept back and synchronise."""
        self._file.write(self._rows)
        self._rows.clear()
        self._flushed = perf_counter()

    def close(self) -> None:
        """Write the rest and close the file."""
        if self._file.is_open:
            self.flush()
            self._file.close()


def _squeeze(values: Array) -> Array:
    """Return the values of a variable of size 1 without their last axis."""
    return values[..., 0] if values.shape[-1] == 1 else values
