"""Times of readings that are written as dates: ISO 8601, or as a format of strptime says. All are in UTC."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from dafw.core.space import Array
from dafw.plugins.readings.files.options import FileOptions
from dafw.plugins.readings.files.table import shown

MICROSECOND = timedelta(microseconds=1)


def dates(cells: Sequence[Any], options: FileOptions, error: Any) -> list[datetime | None]:
    """Return the dates in a column's cells, None where a cell is empty or one of the words for "missing".

    ``error(number, text)`` makes the exception about a cell.
    """
    missing = {word.lower() for word in options.missing} | {""}
    found: list[datetime | None] = []
    for number, cell in enumerate(cells):
        if cell is None or (isinstance(cell, str) and cell.strip().lower() in missing):
            found.append(None)
            continue
        if not isinstance(cell, str):
            expected = "a date" if options.time_format is None else f"a date like {options.time_format!r}"
            raise error(number, f"expected {expected}, as in the other rows, got {shown(cell)}")
        moment = parsed_date(cell, options.time_format)
        if moment is None:
            form = options.time_format
            expected = "seconds or a date in ISO 8601 (time_format says another)" if form is None else repr(form)
            raise error(number, f"expected a time as {expected}, got {shown(cell)}")
        found.append(moment)
    return found


def parsed_date(text: str, form: str | None) -> datetime | None:
    """Return the date in a text, in UTC; without a zone it is taken as UTC. None if the text holds none.

    ``form`` is a format of ``strptime``; a * at its end stands for any text. None: ISO 8601.
    """
    text = text.strip()
    try:
        if form is None:
            return _in_utc(datetime.fromisoformat(text))
        if not form.endswith("*"):
            return _in_utc(datetime.strptime(text, form.strip()))
    except (ValueError, OverflowError):
        return None
    for length in range(min(len(text), 200), 0, -1):  # the longest beginning that is a date
        moment = parsed_date(text[:length], form[:-1])
        if moment is not None:
            return moment
    return None


def _in_utc(moment: datetime) -> datetime:
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)


def in_seconds(stamps: Sequence[datetime | None], epoch: datetime) -> Array:
    """Return dates (R,) as seconds after the epoch, NaN for None."""
    return np.array(
        [np.nan if stamp is None else (stamp - epoch) // MICROSECOND / 1e6 for stamp in stamps], dtype=float
    )
