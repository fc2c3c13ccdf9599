"""Reads fixed entries of a state variable: all of them, every k-th or a given list; every step or less often."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dafw.core.ensemble import Route
from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Observer
from dafw.core.observation import ObservationOperator, Selection, nothing
from dafw.core.options import option
from dafw.core.space import StateSpace
from dafw.plugins.observers.schedule import is_due, require_steps


@dataclass
class Grid(Observer):
    """The observer for studies without coordinates or vehicles."""

    variable: str | None = option(None, "state variable that is read; null: the first")
    indices: list[int] = option([], "entries that are read, counted from 0; empty: use start and stride", minimum=0)
    start: int = option(0, "first entry that is read", minimum=0)
    stride: int = option(1, "distance from one entry that is read to the next; 1: all are read", minimum=1)
    every: float | None = option(
        None, "seconds between readings, the first at the end of the first step; null: every step", above=0.0
    )
    noise_sd: float = option(1.0, "standard deviation of the readings' noise", above=0.0)
    assumed_variance: float | None = option(None, "error variance for the filter; null: noise_sd squared", above=0.0)

    _made: tuple[StateSpace, Selection] | None = field(default=None, init=False, repr=False, compare=False)

    def suit(self, space: StateSpace, dt: float) -> None:
        """Raise ConfigurationError if the variable does not exist or ``every`` is not a multiple of the time step."""
        require_steps(self.every, dt, self.label)
        if self.variable is not None:
            self.require_variable(space, self.variable)

    def operator(self, space: StateSpace, route: Route, t: float) -> ObservationOperator:
        """Return the readings due in this step: all, or none. Raises ConfigurationError for an entry out of range."""
        if not is_due(t, self.every, route.dt):
            return nothing()
        # Made once for each state space, because checking its covariances takes longer than using it.
        if self._made is None or self._made[0] is not space:
            self._made = (space, self._selection(space))
        return self._made[1]

    def _selection(self, space: StateSpace) -> Selection:
        variable = space.variables[0] if self.variable is None else space[self.variable]
        last = max(self.indices) if self.indices else self.start
        if last >= variable.size:
            raise ConfigurationError(
                f"{self.label}: variable '{variable.name}' has {variable.size} entries, there is no entry {last}"
            )
        entries = np.array(self.indices) if self.indices else np.arange(self.start, variable.size, self.stride)
        variance = self.noise_sd**2
        assumed = variance if self.assumed_variance is None else self.assumed_variance
        return Selection(
            indices=entries + space.slice(variable.name).start,
            covariance=np.full(len(entries), assumed),
            noise_covariance=np.full(len(entries), variance),
            coordinates=None if variable.coordinates is None else variable.coordinates[entries],
            sensors=tuple(f"entry {entry}" for entry in entries.tolist()),
        )
