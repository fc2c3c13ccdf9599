"""The checkpoints of a run in progress: written when they are due, removed when the run is complete."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from dafw.core.checkpoints.checkpoint_file import FOLDER, Checkpoint, write_checkpoint
from dafw.core.checkpoints.fingerprint import start_digest
from dafw.core.checkpoints.journal import FORECASTS, ROWS, Journal
from dafw.core.checkpoints.values import UnwritableError, packed
from dafw.core.cycle import Parts, State
from dafw.core.record import Record
from dafw.core.study import Study
from dafw.studies.forecasting import Forecasting
from dafw.studies.reporting import warn_once
from dafw.studies.summary import Summary

log = logging.getLogger("dafw")

LATER = "later/"
"""Prefix, among the arrays of a checkpoint, of revised rows that may be revised again."""


class Checkpointing:
    """Writes the checkpoints of one run.

    ``configuration`` is what ``described`` says of the study, ``start`` the state at its start, ``before`` the
    checkpoint from which it goes on, if there is one. Raises OSError if the folder cannot be made.
    """

    def __init__(
        self,
        study: Study,
        configuration: Mapping[str, Any],
        parts: Parts,
        folder: Path,
        start: State,
        before: Checkpoint | None,
    ) -> None:
        self._plan, self._parts, self._folder = study.checkpoint, parts, folder / FOLDER
        self._configuration, self._start = configuration, start_digest(start)
        self._folder.mkdir(exist_ok=True)
        lengths: Mapping[str, int] = {} if before is None else before.told["journals"]
        wanted = [ROWS, *([FORECASTS] if study.forecast.every is not None else [])]
        self._journals = {name: Journal(self._folder / name, lengths.get(name)) for name in wanted}
        self._done = 0 if before is None else before.cycle
        self._last, self._cost, self._bytes = perf_counter(), 0.0, 0

    @property
    def rows(self) -> Journal:
        """The journal of run.nc."""
        return self._journals[ROWS]

    @property
    def forecasts(self) -> Journal | None:
        """The journal of forecast.nc; None if there are no forecasts."""
        return self._journals.get(FORECASTS)

    def is_due(self, done: int) -> bool:
        """Return whether a checkpoint is due after so many cycles."""
        return self._plan.is_due(done - self._done, perf_counter() - self._last, self._cost)

    def write(self, state: State, record: Record, forecasting: Forecasting | None, summary: Summary) -> None:
        """Write a checkpoint of a state between two cycles. Raises OSError.

        If a plugin's memory holds what a checkpoint cannot, a warning says so once, and there is none.
        """
        if state.cycle == self._done:
            return
        begun = perf_counter()
        arrays: dict[str, np.ndarray] = {}
        try:
            tree = packed(state, self._parts, arrays)
        except UnwritableError as error:
            text = f"no checkpoint can be written, so that the run cannot be resumed: {error}"
            warn_once(summary.warned, "checkpoint", text)
            self._last, self._done = perf_counter(), state.cycle
            return
        self._parts.readings.settle()
        later = record.settle()
        arrays |= {f"{LATER}{place}": values for place, values in later.items()}
        told: dict[str, Any] = {
            "configuration": self._configuration,
            "versions": summary.versions,
            "pinned": summary.pinned,
            "files": dict(summary.files),
            "start": self._start,
            "journals": {name: journal.length() for name, journal in self._journals.items()},
            "state": tree,
            "summary": summary.kept(),
            "forecasting": None if forecasting is None else forecasting.summary(),
        }
        size = write_checkpoint(self._folder, Checkpoint(state.cycle, told, arrays))
        self._last, self._done = perf_counter(), state.cycle
        self._cost = self._last - begun
        said = log.info if not self._bytes or size > 1.5 * self._bytes else log.debug
        said("checkpoint after %d cycles: %.2f MB in %.3f s; two are kept", state.cycle, size / 1e6, self._cost)
        self._bytes = max(size, self._bytes)

    def close(self) -> None:
        """Close the journals. What cannot be written belongs to no checkpoint."""
        for journal in self._journals.values():
            journal.close()
