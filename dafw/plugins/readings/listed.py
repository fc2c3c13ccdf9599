"""A list of readings, given in a configuration or by a script.

Each reading has its own time and may arrive later than it was taken. It belongs to a place, to which the state is
interpolated between the nodes, or to an entry of a variable without coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from dafw.core.domain import Domain
from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Readings
from dafw.core.interfaces.readings import FORGIVEN, Request
from dafw.core.interpolation import weights_at
from dafw.core.observation import Interpolation, Observation
from dafw.core.options import option
from dafw.core.space import Array, IntArray, StateSpace

KEYS = ("time", "value", "x", "y", "entry", "sd", "span", "arrives")


@dataclass
class Listed(Readings):
    """Readings given as a list of mappings.

    Each has ``time`` (s), ``value``, and ``x`` and ``y`` (m) or ``entry`` (counted from 0; a variable of one number
    needs neither). It may have ``sd``, the standard deviation of its error, ``span``, the seconds until its time over
    which it is a mean, and ``arrives``, the time (s) at which it arrives; by default that is ``time``.
    """

    readings: list[dict[str, Any]] = option(
        [], "mappings with time (s), value, x and y (m) or entry, and optionally sd, span (s) and arrives (s)"
    )
    variable: str | None = option(None, "state variable that was read; null: the first")
    sd: float = option(1e-3, "standard deviation of the error of readings without sd", above=0.0)

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return three readings, one of which comes late."""
        readings = [
            {"time": 0.5, "value": 1.0, "entry": 0},
            {"time": 1.0, "value": 2.0, "entry": 1, "sd": 0.1},
            {"time": 0.7, "value": 3.0, "entry": 2, "arrives": 2.5},
        ]
        return {"readings": readings}

    def __post_init__(self) -> None:
        for number, reading in enumerate(self.readings):
            where = f"readings 'listed': reading {number}"
            if unknown := [key for key in reading if key not in KEYS]:
                raise ConfigurationError(f"{where} has an unknown '{unknown[0]}' (there are: {', '.join(KEYS)})")
            if ("x" in reading) != ("y" in reading) or ("entry" in reading and "x" in reading):
                raise ConfigurationError(f"{where} must have x and y, or entry, got {', '.join(reading)}")
            for key in ("time", "value"):
                if key not in reading:
                    raise ConfigurationError(f"{where} must have a {key}, got {', '.join(reading)}")
            for key, value in reading.items():
                # Numpy numbers are accepted, too, because lists made in Python often come from arrays.
                number_like = isinstance(value, Real) and not isinstance(value, bool)
                if not number_like or not np.isfinite(float(value)):
                    raise ConfigurationError(f"{where}: {key} must be a finite number, got {value!r}")
            if reading.get("sd", self.sd) <= 0.0:
                raise ConfigurationError(f"{where}: sd must be above 0, got {reading['sd']:g}")
            if reading.get("span", 0.0) < 0.0:
                raise ConfigurationError(f"{where}: span must be at least 0, got {reading['span']:g}")
            if reading.get("entry", 0) != int(reading.get("entry", 0)):
                raise ConfigurationError(f"{where}: entry must be a whole number, got {reading['entry']:g}")
            if reading.get("arrives", reading["time"]) < reading["time"]:
                raise ConfigurationError(
                    f"{where} arrives at {reading['arrives']:g} s, before its time, {reading['time']:g} s"
                )

    def cycles_covered(self, dt: float) -> int:
        """Return the number of cycles until the last reading is known, at least one."""
        known = [max(r["time"], r.get("arrives", r["time"])) for r in self.readings]
        return max(1, int(np.ceil(max(known, default=0.0) / dt - FORGIVEN)))

    def suit(self, space: StateSpace, domain: Domain | None, dt: float) -> None:
        """Raise ConfigurationError if a reading's place or entry is not one of the variable."""
        variable = space.variables[0] if self.variable is None else space[self.variable]
        for number, reading in enumerate(self.readings):
            if "entry" not in reading and "x" not in reading and variable.size > 1:
                raise ConfigurationError(
                    f"{self.label}: reading {number} must have x and y, or entry: the variable '{variable.name}' has "
                    f"{variable.size} numbers"
                )
            if "entry" in reading and not 0 <= reading["entry"] < variable.size:
                raise ConfigurationError(
                    f"{self.label}: reading {number} is about entry {reading['entry']}, "
                    f"the variable '{variable.name}' has {variable.size}"
                )
            if "x" in reading and domain is not None and not domain.contains(np.array([reading["x"], reading["y"]])):
                raise ConfigurationError(
                    f"{self.label}: reading {number} at ({reading['x']:g}, {reading['y']:g}) m lies outside the domain"
                )
        self._entries(self.readings, space, domain)

    def _entries(
        self, readings: Sequence[Mapping[str, Any]], space: StateSpace, domain: Domain | None
    ) -> tuple[IntArray, Array]:
        """Return for each reading the indices of entries of the state and their weights, both (R, 3)."""
        variable = space.variables[0] if self.variable is None else space[self.variable]
        indices, weights = np.zeros((len(readings), 3), dtype=np.int64), np.zeros((len(readings), 3))
        triangles = domain.triangles if domain is not None and variable is space.variables[0] else None
        for row, reading in enumerate(readings):
            if "x" not in reading:
                indices[row], weights[row, 0] = int(reading.get("entry", 0)), 1.0
        placed = [row for row, reading in enumerate(readings) if "x" in reading]
        if placed:
            places = np.array([[readings[row]["x"], readings[row]["y"]] for row in placed], dtype=np.float64)
            found, shares = weights_at(variable, triangles, places)
            indices[placed, : found.shape[1]], weights[placed, : shares.shape[1]] = found, shares
        return indices + space.slice(variable.name).start, weights

    def take(self, request: Request, rng: np.random.Generator) -> Sequence[Observation]:
        """Return an observation for each reading that arrived in this cycle; the first cycle includes earlier ones."""
        arrives = np.array([r.get("arrives", r["time"]) for r in self.readings], dtype=np.float64)
        due = [self.readings[row] for row in np.flatnonzero(request.arrived(arrives))]
        indices, weights = self._entries(due, request.space, request.domain)
        taken = []
        for row, reading in enumerate(due):
            operator = Interpolation(
                indices=indices[row : row + 1],
                weights=weights[row : row + 1],
                covariance=np.array([reading.get("sd", self.sd) ** 2]),
                coordinates=np.array([[reading["x"], reading["y"]]]) if "x" in reading else None,
                spans=np.array([float(reading["span"])]) if reading.get("span") else None,
            )
            time = min(float(reading["time"]), request.end)  # it may be later by rounding
            taken.append(Observation(np.array([reading["value"]]), operator, time))
        return taken
