"""Readings that are means over some time, and what a run of the model predicts for them.

A reading at time t with the span S is the mean over (t - S, t]. A run knows the state at the ends of its cycles. So it
predicts the mean of what is read at the ends of those cycles that end within the span: S / dt of them, at least one,
and none from before the run begins.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dafw.core.observation import ObservationOperator, Stacked
from dafw.core.space import Array, IntArray

MOST = 2**40
"""More cycles than any run has."""


def cycles_of(operator: ObservationOperator, dt: float) -> IntArray:
    """Return over how many cycles of ``dt`` seconds each of the readings (m,) is a mean; 1: at the end of its own."""
    if operator.spans is None:
        return np.ones(operator.size, dtype=np.int64)
    return np.clip(np.rint(operator.spans / dt), 1.0, MOST).astype(np.int64)


def begins(operators: Mapping[int, ObservationOperator], dt: float) -> int:
    """Return the first cycle that predictions need; ``operators`` are keyed by the number of their cycle."""
    return min(cycle + 1 - int(cycles_of(one, dt).max(initial=1)) for cycle, one in operators.items())


class Means:
    """Which operators a run applies at the end of each cycle, and the means of what they read.

    ``operators`` are keyed by the number of their cycle; the run begins with cycle ``first``.
    """

    def __init__(self, operators: Mapping[int, ObservationOperator], first: int, dt: float) -> None:
        self._operators = operators
        self._counts = {
            cycle: np.minimum(cycles_of(one, dt), cycle + 1 - first)
            for cycle, one in operators.items()
            if one.spans is not None
        }
        self._users: dict[int, list[int]] = {cycle: [cycle] for cycle in operators}
        for cycle, counts in self._counts.items():
            for earlier in range(cycle + 1 - int(counts.max(initial=1)), cycle):
                self._users.setdefault(earlier, []).append(cycle)

    @property
    def applied(self) -> Mapping[int, ObservationOperator]:
        """The operators to apply, keyed by the number of the cycle; those given, if no reading has a span."""
        return {cycle: _together([self._operators[one] for one in users]) for cycle, users in self._users.items()}

    def of(self, read: Mapping[int, Array]) -> Mapping[int, Array]:
        """Return the predictions (N, m) of the operators given, from what those applied read."""
        if not self._counts:
            return read
        parts: dict[tuple[int, int], Array] = {}
        for cycle, users in self._users.items():
            ends = np.cumsum([self._operators[one].size for one in users])[:-1]
            for one, part in zip(users, np.split(read[cycle], ends, axis=1), strict=True):
                parts[cycle, one] = part
        predicted = {}
        for cycle in self._operators:
            total = parts[cycle, cycle].copy()
            counts = self._counts.get(cycle, np.ones(total.shape[1], dtype=np.int64))
            for back in range(1, int(counts.max(initial=1))):
                total += np.where(back < counts, parts[cycle - back, cycle], 0.0)
            predicted[cycle] = total / counts
        return predicted


def _together(operators: list[ObservationOperator]) -> ObservationOperator:
    """Return one operator that reads what all of them read, side by side; their errors do not matter here."""
    if len(operators) == 1:
        return operators[0]
    return Stacked(parts=tuple(operators), covariance=np.ones(sum(one.size for one in operators)))
