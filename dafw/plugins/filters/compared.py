"""The readings that an analysis uses, in the form in which a filter with re-runs compares them with predictions.

**Which readings.** All readings of the window, or those that no earlier analysis has used (``unused``). Late readings
are appended to those of their cycle, so a number for each cycle tells which of its readings were used.

**Model error.** The readings' covariance R is increased by what the model cannot explain, an absolute part a and a
part b relative to the reading::

    R <- R + diag(a^2 + (b y)^2)

**Logarithms.** A concentration is a few large numbers and many near zero, and its errors are of the order of its size.
Differences of logarithms are nearer to Gaussian. With the floor c0, readings and predictions are compared as ::

    z = log(max(y, 0) + c0)
    standard deviation of z = log(1 + s / (max(y, 0) + c0))         s: standard deviation of y, model error included

For s much smaller than y + c0 this is the usual linearisation s / (y + c0); for a reading of zero it is how far one
standard deviation upwards moves z. Correlations are kept. What lies below c0 counts as nothing, so c0 should be about
the smallest concentration that means something.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dafw.core.ensemble import Memory
from dafw.core.observation import ObservationOperator
from dafw.core.rerun import Replay
from dafw.core.space import Array, IntArray
from dafw.core.window import Window


@dataclass(frozen=True)
class Comparison:
    """How readings are compared with predictions; the attributes are those of the options of the filters."""

    logarithm: bool = False
    floor: float = 1e-3
    model_error: float = 0.0
    relative_model_error: float = 0.0

    def of(self, values: Array) -> Array:
        """Return readings or predictions (..., m) in the form that is compared."""
        return np.log(np.maximum(values, 0.0) + self.floor) if self.logarithm else values

    def covariance(self, values: Array, covariance: Array) -> Array:
        """Return the covariance of the compared readings; (m,) where ``covariance`` is, else (m, m)."""
        added = self.model_error**2 + (self.relative_model_error * values) ** 2
        total = covariance + (added if covariance.ndim == 1 else np.diag(added))
        if not self.logarithm:
            return np.asarray(total)
        sd = np.sqrt(total if total.ndim == 1 else np.diag(total))
        scale = np.log1p(sd / (np.maximum(values, 0.0) + self.floor)) / sd
        return np.asarray(total * (scale**2 if total.ndim == 1 else np.outer(scale, scale)))


@dataclass(frozen=True, eq=False)
class Compared:
    """The readings of an analysis.

    ``values`` (M,) and ``covariance``, (M,) or (M, M), are in the form that is compared. ``operators`` are keyed by the
    number of the cycle at whose end they are applied; ``columns`` (M,) are those of their predictions side by side
    that are used.
    """

    values: Array
    covariance: Array
    operators: Mapping[int, ObservationOperator]
    columns: IntArray
    comparison: Comparison

    def predicted(self, replay: Replay) -> Array:
        """Return what the members of a re-run predict for the readings (N, M), in the form that is compared."""
        return self.comparison.of(replay.stacked()[:, self.columns])


def compared(window: Window, comparison: Comparison, used: Mapping[int, int]) -> Compared:
    """Return the readings of the window without the first ``used`` of each cycle, a number for each cycle."""
    new = np.concatenate(
        [np.arange(cycle.observation.values.size) >= used.get(cycle.number, 0) for cycle in window.cycles]
    )
    columns = np.flatnonzero(new)
    values, R = window.values[columns], window.covariance  # noqa: N806
    R = R[columns] if R.ndim == 1 else R[np.ix_(columns, columns)]  # noqa: N806
    # Operators without a new reading are applied as well: they cost little, and the columns stay in their places.
    operators = {cycle.number: cycle.observation.operator for cycle in window.cycles}
    return Compared(comparison.of(values), comparison.covariance(values, R), operators, columns, comparison)


def counted(window: Window) -> dict[int, int]:
    """Return how many readings each cycle of the window has."""
    return {cycle.number: cycle.observation.values.size for cycle in window.cycles}


def remembered(readings: Mapping[int, int], used: Mapping[int, int]) -> Memory:
    """Return as a filter's memory how many readings each cycle has, and how many of them were used."""
    cycles = sorted(readings)
    return {
        "cycle": np.array(cycles, dtype=np.int64),
        "readings": np.array([readings[cycle] for cycle in cycles], dtype=np.int64),
        "used": np.array([used.get(cycle, 0) for cycle in cycles], dtype=np.int64),
    }


def recalled(memory: Memory | None, name: str) -> dict[int, int]:
    """Return a number for each cycle from a memory: its ``readings``, or how many of them were ``used``."""
    if memory is None:
        return {}
    return dict(zip(memory["cycle"].tolist(), memory[name].tolist(), strict=True))
