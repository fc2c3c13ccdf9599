"""The readings of one cycle, as they come: understood one by one, so that garbage spoils nothing but itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from hashlib import blake2b
from math import inf

from dafw.core.errors import ReadingsError
from dafw.core.interfaces.readings import FORGIVEN
from dafw.plugins.readings.feed.journal import Entry
from dafw.plugins.readings.feed.messages import Message, UnusableError, read_message
from dafw.plugins.readings.feed.state import FeedState, Reading
from dafw.plugins.readings.files.sensors import ErrorOptions
from dafw.plugins.readings.files.units import linear

MOST_SENSORS = 1000
"""Different names of sensors that a run keeps apart."""
FAR = 1e12
"""Seconds before t = 0, some 30,000 years, that no time can be."""
STAMP = 2e-6
"""Seconds by which a date, rounded to microseconds, may be beyond the end of its cycle."""
WORLD = 1e9
"""Metres from the middle of a site that no place can be."""
SENSE = 1e30
"""Values and standard deviations above it, and standard deviations below its inverse, are no readings."""
BEYOND = 10.0
"""A value so many times beyond what the model can produce is no reading."""


@dataclass(frozen=True)
class Rules:
    """What a study expects of readings.

    ``names`` are those of ``names_of``, ``wanted`` is the unit of the variable, ``errors`` by sensor their errors and
    ``common`` those of all others. ``places``: the kinds of places that a reading may have, none: it needs no place.
    ``size``: the entries of the variable; ``plausible``: the largest value that the model can produce. ``known`` are
    the only sensors that are used, None: all; ``entries`` are those that they read. ``vehicles``: the numbers of the
    sensors on vehicles. ``first``: whether the first reading is t = 0. ``stamped``: whether a reading without a time
    has that of its arrival. ``furthest``: how many seconds beyond the cycle a reading may be. ``most``: how many
    readings a cycle may have.
    """

    names: Mapping[str, str]
    wanted: str
    errors: Mapping[str, ErrorOptions]
    common: ErrorOptions
    places: tuple[str, ...]
    size: int
    plausible: float = inf
    known: frozenset[str] | None = None
    entries: Mapping[str, int] = field(default_factory=dict)
    vehicles: Mapping[str, int] = field(default_factory=dict)
    unit: str | None = None
    time_format: str | None = None
    lowest: float | None = None
    highest: float | None = None
    first: bool = False
    stamped: bool = False
    furthest: float = 3600.0
    most: int = 10000

    def vehicle(self, sensor: str) -> int | None:
        """Return the number of the vehicle that carries a sensor; None if it is on none."""
        if self.vehicles:
            return self.vehicles.get(sensor)
        word, _, number = sensor.partition(" ")
        return int(number) if word == "drone" and number.isdecimal() and len(number) < 4 else None


class Desk:
    """Takes the entries of one cycle, which ends at ``end`` (s), and changes ``state`` with them."""

    def __init__(self, rules: Rules, state: FeedState, end: float, dt: float) -> None:
        self.rules, self.state, self.end = rules, state, end
        self.slack = max(FORGIVEN * dt, min(STAMP, 0.01 * dt))
        self.due: list[Reading] = []
        self.left_out: Counter[str] = Counter()
        self.notes: list[str] = []
        waiting, state.waiting = state.waiting, []
        for reading in waiting:
            self._keep(reading)

    def put(self, entry: Entry) -> None:
        """Take an entry; what cannot be used is counted."""
        line = entry.line
        try:
            if line.left_out:
                raise UnusableError(line.left_out)
            self._take(read_message(line.text, self.rules.names, self.rules.time_format), entry.at)
        except UnusableError as error:
            self.left_out[error.reason] += line.count
            if str(error) and error.reason not in self.state.shown:
                self.state.shown.append(error.reason)
                self.notes.append(f"the first message left out, {error.reason.replace('_', ' ')}: {error}")

    def _take(self, message: Message, at: float) -> None:
        state, rules = self.state, self.rules
        if message.end:
            state.ended = True
            return
        if message.until is not None:
            state.until = max(state.until, self._near(self._seconds(message.until)))
            return
        if message.time is not None:
            time = self._near(self._seconds(message.time))
        elif rules.stamped and state.zero is not None:
            time = at - state.zero
        else:
            raise UnusableError("incomplete", "it has no time")
        said = (message.value, message.sd, message.unit, message.sensor, message.kind, message.place, message.span)
        reading = Reading(time, *said)
        if reading.value is None:
            if rules.vehicle(reading.sensor) is None:
                return  # where a sensor is that is on no vehicle: nobody asks
        else:
            self._require_known(reading)
        state.latest = max(state.latest, time)
        self._keep(reading)

    def _seconds(self, given: float | datetime) -> float:
        """Return a time of a message in seconds after t = 0."""
        state = self.state
        if isinstance(given, datetime):
            moment = given.timestamp()
            if state.zero is None:
                state.zero = moment
            return moment - state.zero
        if state.seconds is None:
            state.seconds = given if self.rules.first else 0.0
        return given - state.seconds

    def _near(self, time: float) -> float:
        if time < -FAR:
            raise UnusableError("impossible", f"its time is {time:g} s")
        if time > self.end + self.rules.furthest:
            raise UnusableError("too_far_ahead", f"its time is {time:g} s, the cycle ends at {self.end:g} s")
        return time

    def _require_known(self, reading: Reading) -> None:
        """Raise UnusableError for a reading that the study cannot use, or that came before."""
        rules, state = self.rules, self.state
        if rules.known is not None and reading.sensor not in rules.known:
            raise UnusableError("unknown_sensor", f"the sensor '{reading.sensor}' is not among those of the study")
        if rules.places and reading.kind not in rules.places:
            raise UnusableError("incomplete", f"it has no place ({' or '.join(rules.places)})")
        if rules.entries:
            reading.kind, reading.place = "entry", (float(rules.entries[reading.sensor]),)
        if reading.kind == "entry" and reading.place[0] >= rules.size:
            raise UnusableError("outside", f"its entry is {reading.place[0]:g}, the variable has {rules.size}")
        if reading.kind == "metres" and max(map(abs, reading.place)) > WORLD:
            raise UnusableError("outside", f"its place is {reading.place[0]:g}, {reading.place[1]:g} m")
        key = int.from_bytes(blake2b(repr(reading.key).encode(), digest_size=8).digest())
        if state.is_known(key):
            raise UnusableError("doubled")
        before = state.units.get(reading.sensor)
        if before is None and len(state.units) >= MOST_SENSORS:
            raise UnusableError("too_many_sensors", f"there are {MOST_SENSORS} already")
        unit = rules.unit if rules.unit is not None else reading.unit
        if before and not unit:
            raise UnusableError("unit_missing", f"the sensor '{reading.sensor}' told the unit {before} before")
        try:
            shift, factor = linear(unit or rules.wanted, rules.wanted)
        except ReadingsError as error:
            raise UnusableError("unknown_unit", str(error)) from None
        if before and unit != before and "unit_changed" not in state.shown:
            state.shown.append("unit_changed")
            self.notes.append(f"the sensor '{reading.sensor}' changed its unit from {before} to {unit}; both are used")
        errors = rules.errors.get(reading.sensor, rules.common)
        if reading.sd is None and errors.sd is None:
            raise UnusableError("no_sd", "it has no standard deviation: expected 'sd' or the option sd")
        value, sd = reading.value or 0.0, abs(factor) * (errors.sd or 1.0 if reading.sd is None else reading.sd)
        low = rules.lowest is not None and value < rules.lowest
        high = rules.highest is not None and value > rules.highest
        limit = min(SENSE, BEYOND * rules.plausible)
        if low or high or abs(shift + factor * (value - errors.background)) > limit or not 1.0 / SENSE < sd < SENSE:
            raise UnusableError("impossible", f"its value is {value:g}, its standard deviation {sd:g}")
        reading.unit = unit
        state.units[reading.sensor] = unit
        state.remember(key)

    def _keep(self, reading: Reading) -> None:
        """Put a reading to those of this cycle, or of later ones."""
        kept = self.due if reading.time <= self.end + self.slack else self.state.waiting
        if len(kept) >= self.rules.most:
            self.left_out["too_many"] += 1
        else:
            kept.append(reading)

    def is_over(self, grace: float) -> bool:
        """Return whether the feed itself says that the cycle has its readings."""
        return self.has_all or self.state.latest > self.end + self.slack + grace

    @property
    def has_all(self) -> bool:
        """Whether a message said that all readings of the cycle have been sent."""
        return self.state.until >= self.end - self.slack

    @property
    def is_barren(self) -> bool:
        """Whether a feed that has ended has nothing for this cycle or later ones."""
        return not self.due and not self.state.waiting and not self.has_all
