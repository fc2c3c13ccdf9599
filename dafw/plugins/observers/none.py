"""No instruments: for studies whose readings come from a list or another source."""

from __future__ import annotations

from dataclasses import dataclass

from dafw.core.ensemble import Route
from dafw.core.interfaces import Observer
from dafw.core.observation import ObservationOperator, nothing
from dafw.core.space import StateSpace


@dataclass
class NoObserver(Observer):
    """Reads nothing."""

    def operator(self, space: StateSpace, route: Route, t: float) -> ObservationOperator:
        """Return the operator of no readings."""
        return nothing()
