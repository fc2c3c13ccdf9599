"""One message of a feed: a line of JSON, as docs/live.md describes it.

Whatever cannot be understood is refused with the reason under which it is counted; no text whatever raises another
error, and no message may be longer than LONGEST.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import datetime
from math import isfinite, isnan
from typing import Any

from dafw.plugins.readings.files.cells import LIMITS, SYNONYMS
from dafw.plugins.readings.files.options import ColumnOptions
from dafw.plugins.readings.files.table import PLACES, shown
from dafw.plugins.readings.files.times import parsed_date

LONGEST = 65536
"""Bytes that a message may have."""
NAME = 60
"""Characters that the name of a sensor and a unit may have."""
MISSING = ("", "nan", "na", "n/a", "null", "none", "-", "--")
"""Texts that stand for a missing number."""
NUMBERS = ("value", "sd", "span", "x", "y", "lon", "lat", "entry")
TEXTS = ("unit", "sensor")


class UnusableError(Exception):
    """A message that cannot be used: ``reason`` is the word under which it is counted, the text says more."""

    def __init__(self, reason: str, text: str = "") -> None:
        super().__init__(text)
        self.reason = reason


@dataclass(frozen=True)
class Message:
    """What a line says.

    ``value`` is None in a message that only says where a sensor is. ``place`` has the numbers of the columns that
    ``kind``, a key of PLACES, names; both are empty if there is no place. ``time`` is a number of seconds or a date,
    None if the message has none. ``until``: all readings up to that time have been sent. ``end``: the feed has ended.
    ``span``: seconds until the time over which the value is a mean, 0 if it is none.
    """

    time: float | datetime | None = None
    value: float | None = None
    sd: float | None = None
    unit: str = ""
    sensor: str = ""
    kind: str = ""
    place: tuple[float, ...] = ()
    until: float | datetime | None = None
    end: bool = False
    span: float = 0.0


def names_of(columns: ColumnOptions) -> dict[str, str]:
    """Return by a message's own key, in small letters, what it means."""
    found = {"until": "until", "end": "end"}
    for role in (entry.name for entry in fields(columns)):
        given = getattr(columns, role)
        found |= {name.lower(): role for name in ((given,) if given is not None else SYNONYMS.get(role, (role,)))}
    return found


def read_message(text: str, names: Mapping[str, str], time_format: str | None = None) -> Message:
    """Return what a line says; ``names`` are those of ``names_of``. Raises UnusableError."""
    try:
        given = json.loads(text)
    except (ValueError, RecursionError):
        raise UnusableError("unreadable", f"expected a JSON object, got {shown(text)}") from None
    if not isinstance(given, dict):
        raise UnusableError("unreadable", f"expected a JSON object, got {shown(text)}")
    cells = {names[key.lower()]: value for key, value in given.items() if key.lower() in names}
    if cells.get("end") is True:
        return Message(end=True)
    if "until" in cells:
        until = _time(cells["until"], time_format)
        if until is None:
            raise UnusableError("incomplete", "'until' has no time")
        return Message(until=until)
    time = _time(cells.get("time"), time_format)
    if "time" in cells and time is None:
        raise UnusableError("incomplete", f"it has no time: {shown(text)}")
    numbers = {role: _number(cells[role], role) for role in NUMBERS if role in cells}
    texts = {role: _text(cells[role], role) for role in TEXTS if role in cells}
    if "value" in cells and numbers["value"] is None:
        raise UnusableError("incomplete", f"it has no value: {shown(text)}")
    if (sd := numbers.get("sd")) is not None and sd <= 0.0:
        raise UnusableError("impossible", f"expected a standard deviation above 0, got {sd:g}")
    if (span := numbers.get("span") or 0.0) < 0.0:
        raise UnusableError("impossible", f"expected a span of at least 0, got {span:g}")
    kind, place = _place(numbers)
    if "value" not in cells and (kind not in ("metres", "degrees") or not texts.get("sensor")):
        raise UnusableError("incomplete", f"it has no value: {shown(text)}")
    unit, sensor = texts.get("unit", ""), texts.get("sensor", "")
    return Message(time, numbers.get("value"), sd, unit, sensor, kind, place, span=span)


def _time(cell: Any, time_format: str | None) -> float | datetime | None:
    """Return seconds, or a date in UTC; None if there is no time."""
    if isinstance(cell, str) and cell.strip().lower() not in MISSING and (time_format or not _is_number(cell)):
        moment = parsed_date(cell[:200], time_format)
        if moment is None:
            raise UnusableError("wrong_time", f"expected seconds or a date, got {shown(cell)}")
        return moment
    return _number(cell, "time")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _number(cell: Any, role: str) -> float | None:
    """Return a finite number; None where it is missing."""
    if cell is None or (isinstance(cell, str) and cell.strip().lower() in MISSING):
        return None
    try:
        if isinstance(cell, bool) or not isinstance(cell, str | int | float) or (isinstance(cell, str) and "_" in cell):
            raise ValueError
        value = float(cell)
    except (ValueError, OverflowError):
        raise UnusableError("wrong_number", f"expected a number as {role}, got {shown(cell)}") from None
    if isnan(value):
        return None
    if not isfinite(value):
        raise UnusableError("wrong_number", f"expected a finite number as {role}, got {shown(cell)}")
    low, high = LIMITS.get(role, (value, value))
    if not low <= value <= high:
        raise UnusableError("impossible", f"expected {role} from {low:g} to {high:g}, got {value:g}")
    return value


def _text(cell: Any, role: str) -> str:
    """Return a cell as text: the number 3 and the text "3" name the same sensor."""
    if cell is None:
        return ""
    if isinstance(cell, bool) or not isinstance(cell, str | int | float):
        raise UnusableError("wrong_text", f"expected a text as {role}, got {shown(cell)}")
    text = str(cell).strip()
    if not text.isprintable() or len(text) > NAME:
        raise UnusableError("wrong_text", f"expected at most {NAME} printable characters as {role}, got {shown(cell)}")
    return text


def _place(numbers: Mapping[str, float | None]) -> tuple[str, tuple[float, ...]]:
    """Return where the message says that it was taken: the first kind of PLACES that is complete."""
    for kind, roles in PLACES.items():
        place = tuple(value for role in roles if (value := numbers.get(role)) is not None)
        if len(place) == len(roles):
            if kind == "entry" and (place[0] < 0 or place[0] != int(place[0])):
                raise UnusableError("impossible", f"expected an entry, a whole number from 0, got {place[0]:g}")
            return kind, place
    return "", ()
