"""Readings that somebody recorded, from a CSV, netCDF or GeoJSON file (docs/readings.md).

The file is read before a run begins. A reading has its own time and place; it may belong to one of several sensors,
each with its own errors. What cannot be used is left out and counted: incomplete and doubled rows, places outside the
site or inside a building. Readings from before the start are counted by the loop, like those of every other source.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from dafw.core.domain import Domain
from dafw.core.ensemble import Memory
from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Readings
from dafw.core.interfaces.readings import FORGIVEN, Request, Taken
from dafw.core.observation import Interpolation, Observation
from dafw.core.options import build, option
from dafw.core.space import Array, StateSpace
from dafw.plugins.observers.path import ends_of
from dafw.plugins.readings.files.any_file import EXAMPLE, paths_of, read_table
from dafw.plugins.readings.files.options import FileOptions
from dafw.plugins.readings.files.placing import (
    Placed,
    entries_of_sensors,
    placed,
    placed_on_paths,
    plane_origin,
    require_origin,
)
from dafw.plugins.readings.files.screening import (
    REASONS,
    complete,
    converted,
    in_study_time,
    possible,
    require_computable,
    start_of,
    with_unit,
    without_doubles,
)
from dafw.plugins.readings.files.sensors import (
    REPEATED,
    SensorOptions,
    averaged,
    censored,
    sensors_of,
    undone_response,
    with_errors,
    without_repeats,
)
from dafw.plugins.readings.files.table import Table
from dafw.plugins.readings.files.units import linear


@dataclass(frozen=True, eq=False)
class Usable:
    """The readings of a file in the time of a study, before they are placed.

    ``counts`` are keyed by REASONS: rows that are left out. ``below`` and ``repeated`` are the numbers of readings
    below the detection limit, and of those at a time at which their sensor has another one.
    """

    table: Table
    kind: str | None
    start: float
    counts: Mapping[str, int]
    below: int
    repeated: int


@dataclass(frozen=True, eq=False)
class Fitted:
    """Readings as observations of one state space: ``values`` and ``variances`` (R,) in ``units``, the variable's.

    ``limits`` (R,) are the detection limits of the readings below them, NaN for all others; ``spans`` (R,) the seconds
    over which readings are means.
    """

    table: Table
    values: Array
    variances: Array
    limits: Array
    spans: Array
    placed: Placed
    arrives: Array
    counts: Mapping[str, int]
    units: str


@dataclass
class Recorded(SensorOptions, FileOptions, Readings):
    """Readings from a file."""

    start: float | str | None = option(
        None, "what is t = 0: a time as in the file (s, or a date), or first: its first reading; null: 0 s"
    )
    origin: list[float] | str | None = option(
        None, "[lon, lat] of the plane's (0, 0) in degrees, or first: where the first reading is; null: the site's"
    )
    variable: str | None = option(None, "state variable that was read; null: the first")
    unit: str | None = option(None, "unit of the values; null: what the file says, else that of the variable")
    reference: str | None = option(None, "what 1 of the variable stands for, such as '250 mg m-3'; null: its own unit")
    repeated: str = option(
        "keep", "several readings of a sensor at one time: keep them, the first, or their mean", choices=REPEATED
    )
    lowest: float | None = option(None, "values below it, in the unit of the file, cannot be and are left out")
    highest: float | None = option(None, "values above it cannot be and are left out")
    entries: dict[str, int] = option({}, "by sensor: the entry of the variable that it reads, from 0", minimum=0)
    paths: dict[str, Any] = option(
        {}, "by sensor: the line along which it reads the mean of the variable, [[x, y], [x, y]] in metres"
    )
    sensors: dict[str, Any] = option(
        {}, "by sensor: a mapping with its own sd, relative_sd, background, detection_limit, response_time, averaging"
    )

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return the file that ships with dafw, from a time at which its drone was in the kit's rectangle."""
        return {"file": EXAMPLE, "start": 15.0}

    def __post_init__(self) -> None:
        require_origin(self.origin, "readings 'recorded'")
        if self.entries and self.paths:
            raise ConfigurationError("readings 'recorded': sensors have entries or paths, not both")
        ends_of(self.paths, "readings 'recorded'")
        for name, own in self.sensors.items():
            where = f"readings 'recorded', sensor '{name}'"
            if not isinstance(own, Mapping):
                raise ConfigurationError(f"{where}: expected a mapping of options, got {own!r}")
            build(SensorOptions, own, where)

    @property
    def input_files(self) -> Sequence[Path]:
        """The files with the readings."""
        return paths_of(self)

    @cached_property
    def rows(self) -> Table:
        """The file's rows as they are; raises ReadingsError."""
        return with_unit(read_table(self), self.unit)

    @cached_property
    def usable(self) -> Usable:
        """The readings, with errors, in the time of the study; raises ReadingsError."""
        rows = self.rows
        if self.entries:
            rows = rows.changed(entry=entries_of_sensors(rows, self.entries))
        kind = "entry" if self.entries else None if self.paths else rows.place_kind(self.place)
        table, incomplete = complete(rows, kind)
        table, doubled = without_doubles(table)
        table, impossible = possible(table, self.lowest, self.highest)
        start = start_of(table, self.start)
        sensors = sensors_of(table, self, self.sensors, "readings 'recorded'")
        table = require_computable(with_errors(in_study_time(table, start), sensors))
        table, repeated = without_repeats(averaged(table, sensors), self.repeated)
        table, slow = undone_response(table, sensors)
        table, below = censored(table, sensors)
        dropped = 0 if self.repeated == "keep" else repeated
        counts = dict(incomplete=incomplete, doubled=doubled, impossible=impossible, repeated=dropped, slow_start=slow)
        return Usable(table, kind, start, counts, below, repeated)

    @property
    def plane_origin(self) -> tuple[float, float] | None:
        """The longitude and latitude of the plane's (0, 0); None: those of the site; raises ReadingsError."""
        return plane_origin(self.rows, self.origin)

    def cycles_covered(self, dt: float) -> int:
        """Return the number of cycles until the last reading of the file is known, at least one."""
        table = self.usable.table
        known = np.fmax(table.number("time"), table.number("arrives"))
        return max(1, int(np.ceil(known.max(initial=0.0) / dt - FORGIVEN)))

    def suit(self, space: StateSpace, domain: Domain | None, dt: float) -> None:
        """Read the file; raises ReadingsError if it cannot be read, or if none of its readings can be used."""
        fitted = self._fitted(space, domain)
        if not (fitted.table.number("time") > 0.0).any():
            left = [f"{count} {REASONS[reason]}" for reason, count in fitted.counts.items() if count]
            early = len(fitted.table)
            raise self.rows.error(
                f"none of its {len(self.rows)} rows can be used: "
                + ", ".join(
                    [*left, *([f"{early} not after the start of the study"] if early else [])] or ["it has none"]
                )
            )

    def _fitted(self, space: StateSpace, domain: Domain | None) -> Fitted:
        """Return the readings as observations of a state; kept, because every cycle asks for the same."""
        kept = self.__dict__.get("_kept")
        if kept is not None and kept[0] is space and kept[1] is domain:
            found: Fitted = kept[2]
            return found
        usable = self.usable
        variable = space.variables[0] if self.variable is None else space[self.variable]
        values, sd, limits = converted(usable.table, self.reference or variable.units)
        if self.paths:
            at = placed_on_paths(
                usable.table, space, self.variable, ends_of(self.paths, "readings 'recorded'"), self.label
            )
        else:
            at = placed(usable.table, usable.kind, space, domain, self.variable, self.plane_origin)
        free = ~(at.outside | at.in_building)
        table = usable.table.chosen(free)
        counts = {**usable.counts, "outside": int(at.outside.sum()), "in_building": int(at.in_building.sum())}
        coordinates = None if at.coordinates is None else at.coordinates[free]
        nowhere = np.zeros(len(table), dtype=np.bool_)
        at = Placed(at.indices[free], at.weights[free], coordinates, nowhere, nowhere)
        late = table.number("arrives")
        arrives = np.where(np.isnan(late), table.number("time"), late)
        spans = np.nan_to_num(table.number("span"))
        fitted = Fitted(table, values[free], sd[free] ** 2, limits[free], spans, at, arrives, counts, variable.units)
        self.__dict__["_kept"] = (space, domain, fitted)
        return fitted

    def take_with_memory(self, request: Request, memory: Memory | None, rng: np.random.Generator) -> Taken:
        """Return an observation for each time of which readings arrived in this cycle, or by then in the first."""
        fitted = self._fitted(request.space, request.domain)
        due = np.flatnonzero(request.arrived(fitted.arrives))
        times = np.minimum(fitted.table.number("time")[due], request.end)
        named, limited = any(fitted.table.text("sensor")), not np.isnan(fitted.limits).all()
        spanned = bool(fitted.spans.any())
        taken = []
        for time in np.unique(times).tolist():
            rows = due[times == time]
            at = fitted.placed
            operator = Interpolation(
                indices=at.indices[rows],
                weights=at.weights[rows],
                covariance=fitted.variances[rows],
                coordinates=None if at.coordinates is None else at.coordinates[rows],
                sensors=tuple(fitted.table.text("sensor")[rows]) if named else None,
                limits=fitted.limits[rows] if limited else None,
                spans=fitted.spans[rows] if spanned else None,
            )
            taken.append(Observation(fitted.values[rows], operator, time))
        if request.cycle:
            return Taken(taken)
        return Taken(taken, left_out={reason: count for reason, count in fitted.counts.items() if count})

    def notes(self) -> list[str]:
        """Return what the file holds and how it is used, in one sentence."""
        if "_kept" not in self.__dict__:
            return []
        fitted: Fitted = self.__dict__["_kept"][2]
        time = fitted.table.number("time")
        parts = [f"{len(self.rows)} rows in {self.rows.path}", f"{len(time)} are readings of the site"]
        parts += [f"of t = {time.min():g} to {time.max():g} s"] if len(time) else []
        parts += [f"{count} {REASONS[reason]}" for reason, count in fitted.counts.items() if count]
        parts += [f"{self.usable.below} below the detection limit"] if self.usable.below else []
        if not all(fitted.table.text("unit")):
            parts += ["values without a unit are taken in that of the variable"]
        if self.reference is None and fitted.units in ("", "1"):  # a share of what? often not of what the file means
            units = [one for one in dict.fromkeys(fitted.table.text("unit")) if one]
            factors = {unit: linear(unit, "1")[1] for unit in units}
            parts += [f"1 {unit} is taken as {factor:g}" for unit, factor in factors.items() if factor != 1.0]
        return [f"{self.label}: {', '.join(parts)}"]
