"""From the table of a file to readings in the time of a study; incomplete and doubled rows are left out, counted."""

from __future__ import annotations

from datetime import timedelta

import numpy as np

from dafw.core.errors import ReadingsError
from dafw.core.space import Array
from dafw.plugins.readings.files.table import PLACES, Table, shown
from dafw.plugins.readings.files.times import parsed_date
from dafw.plugins.readings.files.units import linear, require_unit

REASONS = {
    "incomplete": "without a time, a value or a place",
    "doubled": "the same as an earlier row",
    "impossible": "below lowest or above highest",
    "repeated": "of a sensor at a time of which it has another reading (repeated)",
    "slow_start": "the first reading of a sensor with a response time",
    "outside": "outside the site",
    "in_building": "inside a building",
}
"""Why a reading is left out, by the name under which it is counted."""

GREATEST = 1e100
"""The greatest number of a file that is computed with, and its inverse the smallest standard deviation."""


def complete(table: Table, kind: str | None) -> tuple[Table, int]:
    """Return the rows that have a time, a value and a place of a ``kind`` of PLACES, and how many have not."""
    needed = ["time", "value", *(PLACES[kind] if kind else ())]
    whole = ~np.logical_or.reduce([np.isnan(table.number(role)) for role in needed])
    return table.chosen(whole), int((~whole).sum())


def without_doubles(table: Table) -> tuple[Table, int]:
    """Return the table without rows in which every column is the same as in an earlier row, and how many these are."""
    numbers = np.stack([column + 0.0 for column in table.numbers.values()], axis=1)
    seen: set[tuple[object, ...]] = set()
    kept = np.ones(len(table), dtype=bool)
    texts = list(table.texts.values())
    for row, line in enumerate(numbers):
        key = (line.tobytes(), *(text[row] for text in texts))
        kept[row] = key not in seen
        seen.add(key)
    return table.chosen(kept), int((~kept).sum())


def possible(table: Table, lowest: float | None, highest: float | None) -> tuple[Table, int]:
    """Return the rows whose values lie between two numbers, and how many do not."""
    value = table.number("value")
    inside = (value >= (-np.inf if lowest is None else lowest)) & (value <= (np.inf if highest is None else highest))
    return table.chosen(inside), int((~inside).sum())


def require_computable(table: Table) -> Table:
    """Return the table; raises ReadingsError for a number whose square is none."""
    for role in ("value", "sd"):
        column = np.abs(table.number(role))
        wrong = (column > GREATEST) | ((column < 1.0 / GREATEST) & (role == "sd"))
        if wrong.any():
            row = int(np.argmax(wrong))
            least = f"from {1.0 / GREATEST:g} " if role == "sd" else ""
            text = f"expected a number {least}up to {GREATEST:g} that can be computed with"
            raise table.error(f"{text}, got {table.number(role)[row]:g}", row, role)
    return table


def start_of(table: Table, start: float | str | None) -> float:
    """Return the time of the table, in its own seconds, that is t = 0 of the study.

    ``start`` is a number of seconds, a date, or ``first``: the time of the first reading. None: 0 where the file has
    seconds. Raises ReadingsError if it is missing or not of the file's kind.
    """
    time = table.number("time")
    if start == "first":
        return float(time.min()) if len(table) else 0.0
    if table.epoch is None:
        if isinstance(start, str):
            raise table.error(
                f"its times are seconds, expected the option start in seconds or 'first', got {shown(start)}"
            )
        return 0.0 if start is None else float(start)
    if not isinstance(start, str):
        first = table.date(float(time.min())) if len(table) else table.date(0.0)
        raise table.error(
            f"its times are dates, the first of a reading is {first}: expected the option start, the date "
            f"that is t = 0, or 'first'" + ("" if start is None else f", got {start:g}")
        )
    moment = parsed_date(start, None)
    if moment is None:
        raise table.error(f"expected the option start as a date in ISO 8601 or 'first', got {shown(start)}")
    return (moment - table.epoch) // timedelta(microseconds=1) / 1e6


def in_study_time(table: Table, start: float) -> Table:
    """Return the table, sorted by time, with times after the ``start``; readings of the same time keep their order."""
    times = {role: table.numbers[role] - start for role in ("time", "arrives") if role in table.numbers}
    shifted = table.changed(**times) if start else table
    return shifted.chosen(np.argsort(shifted.number("time"), kind="stable"))


def with_unit(table: Table, unit: str | None) -> Table:
    """Return the table with ``unit`` in every row, where given; raises ReadingsError for units that are not known."""
    if unit is not None:
        table = Table(**{**vars(table), "texts": {**table.texts, "unit": np.full(len(table), unit, dtype=object)}})
    for one in dict.fromkeys(table.text("unit")):
        try:
            require_unit(one)
        except ReadingsError as error:
            row = int(np.argmax(table.text("unit") == one))
            raise table.error(str(error), None if unit is not None else row, "value") from None
    return table


def converted(table: Table, wanted: str) -> tuple[Array, Array, Array]:
    """Return values, standard deviations and detection limits (R,) in the unit ``wanted``, which may be a quantity.

    The limits are those of readings below them, NaN for all others. Values without a unit are taken to be in it
    already. Raises ReadingsError for a unit that measures something else.
    """
    value, sd, limit = (table.number(role).copy() for role in ("value", "sd", "limit"))
    for one in dict.fromkeys(table.text("unit")):
        rows = table.text("unit") == one
        try:
            shift, factor = linear(one or wanted, wanted)
        except ReadingsError as error:
            raise table.error(str(error), int(np.argmax(rows)), "value") from None
        if (shift, factor) != (0.0, 1.0):
            value[rows], sd[rows] = shift + factor * value[rows], abs(factor) * sd[rows]
            limit[rows] = shift + factor * limit[rows]
    return value, sd, limit
