"""A wind that a table gives in words: "203°", "2.10 m/s", by a clock that begins again with every flight.

Meteorologists, and most programs for drones, name the direction **from** which the wind blows, clockwise from north. So
203° at 2.10 m/s is a wind from the south-southwest, with these components towards the east and the north::

    u = -speed sin(direction),    v = -speed cos(direction)
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

import numpy as np

from dafw.core.errors import ConfigurationError
from dafw.core.space import Array
from dafw.plugins.readings.files.screening import converted
from dafw.plugins.readings.files.table import Table, shown
from dafw.plugins.readings.files.times import parsed_date

WITHOUT_A_DATE = datetime(1900, 1, 1, tzinfo=UTC)
"""What strptime takes for the date of a time that has none."""


def components_of(direction: Table, speed: Table, blows: str) -> Array:
    """Return a wind (S, 2) in m/s towards the east and the north from columns of directions and speeds.

    Values are converted from the units of their cells; without a unit they are degrees and m/s. ``blows``, ``from`` or
    ``to``, tells whether a direction is that from which the wind comes. Raises ReadingsError for a unit that measures
    something else, and for a speed below 0.
    """
    angle = np.radians(converted(direction, "degree")[0])
    size = converted(speed, "m/s")[0]
    if (size < 0.0).any():
        row = int(np.argmax(size < 0.0))
        raise speed.error(f"expected a speed of at least 0, got {size[row]:g} m/s", row, "value")
    sign = -1.0 if blows == "from" else 1.0
    return sign * np.stack([size * np.sin(angle), size * np.cos(angle)], axis=1)


def on_the_clock(table: Table, starts: Sequence[str | None], start: float | str | None, group: str) -> Array:
    """Return the times (S,) of a table in s after the date ``start``, from a clock that begins again.

    A new part of the table begins wherever the time goes back; ``starts`` has for each part the date at which its clock
    showed 0, or None to leave the part out (NaN). Raises ConfigurationError, which names the ``group`` of the
    options, for dates that are none, and ReadingsError if the table has another number of parts or has dates.
    """
    zero = _date(start, f"{group}.start")
    begins = [None if one is None else _date(one, f"{group}.starts") for one in starts]
    elapsed = table.number("time")
    if table.epoch is not None:
        elapsed = elapsed + (table.epoch - WITHOUT_A_DATE).total_seconds()
        if table.epoch - WITHOUT_A_DATE > timedelta(days=300):
            raise table.error(f"{group}.starts says when its clock showed 0, and its times are dates already")
    known = np.where(np.isnan(elapsed), -np.inf, elapsed)
    before = np.maximum.accumulate(np.where(np.isnan(elapsed), -1, np.arange(len(elapsed))))[:-1]
    back = (known[1:] < np.where(before < 0, -np.inf, known[before])) & np.isfinite(known[1:])
    part = np.append(0, np.cumsum(back))[: len(elapsed)]
    if len(elapsed) and part[-1] + 1 != len(begins):
        raise table.error(
            f"its clock begins {part[-1] + 1} times: expected as many dates in {group}.starts, got {len(begins)}"
        )
    shift = np.array([np.nan if one is None else (one - zero).total_seconds() for one in begins])
    return np.asarray(elapsed + shift[part])


def _date(given: float | str | None, name: str) -> datetime:
    """Return the date that an option says; raises ConfigurationError."""
    moment = parsed_date(given, None) if isinstance(given, str) else None
    if moment is None:
        raise ConfigurationError(f"{name} must be a date in ISO 8601, got {shown(given)}")
    return moment
