"""When a study makes forecasts, how far they reach, and what they tell."""

from __future__ import annotations

from dataclasses import dataclass

from dafw.core.errors import ConfigurationError
from dafw.core.options import option

MEDIAN = 0.5
TOLERANCE = 1e-6
"""How far a time may be from a whole number of time steps, in time steps."""
AREA_UNITS = ("metres", "degrees")


@dataclass
class ForecastPlan:
    """The forecasts of a study. Without ``every`` there are none.

    Raises ConfigurationError if the options do not fit together.
    """

    every: float | None = option(None, "seconds from one forecast to the next; null: no forecasts", above=0.0)
    horizon: float = option(120.0, "how far a forecast reaches, in seconds", above=0.0)
    lead_times: list[float] = option(
        [0.0, 30.0, 60.0, 120.0], "seconds after its issue at which a forecast has maps; 0 is always one", minimum=0.0
    )
    thresholds: list[float] = option(
        [0.01, 0.1], "values of the model's first variable, in its units, that may be exceeded"
    )
    quantiles: list[float] = option([0.1, 0.5, 0.9], "quantiles of times and doses", above=0.0, maximum=1.0)
    contours: list[float] = option(
        [0.1, 0.5, 0.9], "probabilities of exceedance that are drawn as polygons", above=0.0, maximum=1.0
    )
    areas: dict[str, list[list[float]]] = option({}, "named areas: the corners [[x, y], ...] of each")
    area_units: str = option(
        "metres", "what the corners of areas are in; degrees: longitude, latitude", choices=AREA_UNITS
    )
    area_file: str | None = option(None, "a GeoJSON file with polygons, each with a property name")
    verify: bool = option(True, "where there is a truth, run it and the free run ahead, too, to judge the forecasts by")

    def __post_init__(self) -> None:
        if not self.thresholds:
            raise ConfigurationError("option 'thresholds' needs one number or more, got []")
        for name in ("lead_times", "thresholds", "quantiles", "contours"):
            numbers = getattr(self, name)
            if len(set(numbers)) < len(numbers):
                raise ConfigurationError(f"option '{name}' has the same number twice: {numbers}")
        if late := [lead for lead in self.lead_times if lead > self.horizon]:
            raise ConfigurationError(
                f"option 'lead_times' must not exceed the horizon of {self.horizon:g} s, got {late[0]:g}"
            )
        for name, corners in self.areas.items():
            if len(corners) < 3 or any(len(corner) != 2 for corner in corners):
                raise ConfigurationError(f"area '{name}': expected three corners [x, y] or more, got {corners}")

    @property
    def leads(self) -> list[float]:
        """The lead times at which there are maps, in order, in seconds."""
        return sorted({0.0, *map(float, self.lead_times)})

    @property
    def limits(self) -> list[float]:
        """The thresholds, in order."""
        return sorted(map(float, self.thresholds))

    @property
    def shares(self) -> list[float]:
        """The probabilities of the quantiles and the median's, in order."""
        return sorted({MEDIAN, *map(float, self.quantiles)})

    @property
    def probabilities(self) -> list[float]:
        """The probabilities of the contours and the median's, in order."""
        return sorted({MEDIAN, *map(float, self.contours)})

    def is_due(self, done: int, dt: float) -> bool:
        """Return whether a forecast is issued after so many cycles of ``dt`` seconds."""
        return self.every is not None and done > 0 and done % whole_steps(self.every, dt, "every") == 0

    def suit(self, dt: float) -> None:
        """Raise ConfigurationError if the model's time step of ``dt`` seconds does not fit."""
        if self.every is not None:
            whole_steps(self.every, dt, "every")
        whole_steps(self.horizon, dt, "horizon")
        for lead in self.leads:
            whole_steps(lead, dt, "lead_times")


def whole_steps(seconds: float, dt: float, name: str) -> int:
    """Return the number of steps of ``dt`` in a time; raises ConfigurationError unless it is a whole number."""
    steps = round(seconds / dt)
    if abs(seconds / dt - steps) > TOLERANCE or (steps == 0 and seconds > 0.0):
        raise ConfigurationError(
            f"study, forecast: option '{name}' must be a whole number of time steps of {dt:g} s, got {seconds:g}"
        )
    return steps
