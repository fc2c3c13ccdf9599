"""Cells of a file, as texts or as values of JSON and netCDF, turned into the columns of a table."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from math import isfinite, isnan, nan
from typing import Any

import numpy as np

from dafw.core.errors import ReadingsError
from dafw.core.space import Array
from dafw.plugins.readings.files.options import ColumnOptions, FileOptions
from dafw.plugins.readings.files.table import NUMBERS, TEXTS, Table, about, shown
from dafw.plugins.readings.files.times import dates, in_seconds
from dafw.plugins.readings.files.units import linear

SYNONYMS = {"lon": ("lon", "longitude"), "lat": ("lat", "latitude")}
BRACKETED = re.compile(r"^(.*\S)\s*[(\[]([^()\[\]]*)[)\]]$", re.DOTALL)
SECONDS_OR_METRES = {"time": "s", "span": "s", "arrives": "s", "x": "m", "y": "m"}
"""Units of columns of numbers to which the file's own are converted."""
WITH_UNIT = re.compile(r"^([-+]?[\d.,]+(?:[eE][-+]?\d+)?)\s*([^\s\d.,].*)$", re.DOTALL)
"""A number and its unit in one cell."""
LISTED, LONGEST_NAME = 20, 40
"""Columns that a message lists, and characters that it shows of a name."""
LIMITS = {"lon": (-180.0, 360.0), "lat": (-90.0, 90.0)}


@dataclass
class Raw:
    """Cells (R,) by role, as they stand in a file, with the columns' names and units (absent: not told)."""

    path: str
    word: str
    rows: Sequence[int]
    cells: Mapping[str, Sequence[Any]]
    names: Mapping[str, str]
    units: Mapping[str, str]
    others: tuple[str, ...] = ()


def shown_name(name: str) -> str:
    """Return a column's plain name in a line: not too long, and without what cannot be printed."""
    name = plain_name(name)
    return name if name.isprintable() and len(name) <= LONGEST_NAME else shown(name)


def plain_name(name: str) -> str:
    """Return a column's name without spaces and quotes around it."""
    return name.strip().strip("\"'").strip()


def without_unit(name: str) -> tuple[str, str]:
    """Return a column's plain name without the unit in brackets behind it, and that unit ("" if there is none)."""
    found = BRACKETED.match(plain_name(name))
    return (plain_name(found[1]), found[2].strip()) if found else (plain_name(name), "")


def find_columns(headers: Sequence[str], asked: ColumnOptions, path: str) -> dict[str, int]:
    """Return by role the number of the column that holds it; raises ReadingsError for a name that leads nowhere.

    ``time`` and ``value`` must be there.
    """
    whole = [plain_name(name).lower() for name in headers]
    bare = [without_unit(name)[0].lower() for name in headers]
    found = {}
    for role in (entry.name for entry in fields(asked)):
        given = getattr(asked, role)
        candidates = (given,) if given is not None else SYNONYMS.get(role, (role,))
        places: list[int] = []
        for name in candidates:
            places = places or [n for n, one in enumerate(whole) if one == plain_name(name).lower()]
            places = places or [n for n, one in enumerate(bare) if one == plain_name(name).lower()]
        if len(places) > 1:
            raise about(path, f"{len(places)} columns are called {shown(candidates[0])}, expected one")
        if places:
            found[role] = places[0]
        elif given is not None or role in ("time", "value"):
            listed = ", ".join(shown_name(name) for name in headers[:LISTED])
            listed += f" and {len(headers) - LISTED} more" if len(headers) > LISTED else ""
            hint = "" if given is not None else f", say which with columns.{role}"
            raise about(path, f"no column {shown(candidates[0])} (there are: {listed or 'none'}){hint}")
    return found


def made(raw: Raw, options: FileOptions) -> Table:
    """Return the table of a file's cells; raises ReadingsError that names the row and the column of a wrong cell."""
    raw = _split_values(raw) if options.units_in_cells else raw
    numbers: dict[str, Array] = {}
    texts: dict[str, Any] = {}
    epoch: datetime | None = None
    for role in raw.cells:
        if role in TEXTS:
            texts[role] = np.array([_text(cell, raw, n, role) for n, cell in enumerate(raw.cells[role])], dtype=object)
    times = [role for role in ("time", "arrives") if role in raw.cells]
    numeric = _numeric_times(raw, times, options)
    if numeric:
        for role in times:
            numbers[role] = _numbers(raw, role, options)
    else:
        stamps = {role: dates(raw.cells[role], options, _place(raw, role)) for role in times}
        known = [stamp for column in stamps.values() for stamp in column if stamp is not None]
        first = min(known, default=datetime(1970, 1, 1, tzinfo=UTC))
        epoch = first
        numbers |= {role: in_seconds(column, first) for role, column in stamps.items()}
    for role in NUMBERS:
        if role in raw.cells and role not in times:
            numbers[role] = _numbers(raw, role, options)
    if raw.units.get("value") and "unit" not in texts:
        texts["unit"] = np.full(len(raw.rows), raw.units["value"], dtype=object)
    sd_unit = raw.units.get("sd", "")
    if sd_unit and sd_unit != raw.units.get("value", ""):
        raise about(raw.path, f"the sd is in {shown(sd_unit)}, the value in {shown(raw.units.get('value', ''))}")
    table = Table(raw.path, raw.word, np.array(raw.rows, dtype=np.int64), numbers, texts, epoch, raw.names, raw.others)
    _refuse_nonsense(table)
    return table


def _split_values(raw: Raw) -> Raw:
    """Return cells whose values were written with their units, with both in columns of their own."""
    if "unit" in raw.cells:
        raise about(raw.path, "units_in_cells says where units are, and there is a column of units, too")
    values, units = [], []
    for cell in raw.cells["value"]:
        found = WITH_UNIT.match(cell.strip()) if isinstance(cell, str) else None
        values.append(found[1] if found else cell)
        units.append(found[2].strip() if found else raw.units.get("value", ""))
    return replace(raw, cells={**raw.cells, "value": values, "unit": units})


def _place(raw: Raw, role: str) -> Any:
    """Return a function that makes an error about a cell of a column from the cell's number and a text."""

    def error(number: int, text: str) -> ReadingsError:
        return about(raw.path, text, raw.word, raw.rows[number], raw.names.get(role))

    return error


def _numeric_times(raw: Raw, roles: Sequence[str], options: FileOptions) -> bool:
    """Return whether times are numbers of seconds: the first time decides."""
    if options.time_format is not None:
        return False
    for role in roles:
        for cell in raw.cells[role]:
            if not _is_missing(cell, options):
                return not isinstance(cell, str) or _parsed(cell, options) is not None
    return True


def _is_missing(cell: Any, options: FileOptions) -> bool:
    if isinstance(cell, str):
        return cell.strip() == "" or cell.strip().lower() in {word.lower() for word in options.missing}
    return cell is None or (isinstance(cell, float) and isnan(cell))


def _parsed(text: str, options: FileOptions) -> float | None:
    """Return the number in a text; None if it holds none."""
    text = text.strip()
    if options.decimal == "comma":
        text = text.replace(",", ".") if "." not in text else "?"
    try:
        return None if "_" in text else float(text)
    except ValueError:
        return None


def _numbers(raw: Raw, role: str, options: FileOptions) -> Array:
    """Return a column of numbers (R,) in the role's own unit."""
    values = np.empty(len(raw.rows))
    words = {word.lower() for word in options.missing} | {""}
    error = _place(raw, role)
    for n, cell in enumerate(raw.cells[role]):
        values[n] = _number(cell, words, options, n, error)
    unit, wanted = raw.units.get(role, ""), SECONDS_OR_METRES.get(role)
    if not unit or wanted is None or unit == wanted:
        return values
    try:
        shift, factor = linear(unit, wanted)
    except ReadingsError as wrong:
        raise about(raw.path, f"{wrong}", column=raw.names.get(role)) from None
    return values if (shift, factor) == (0.0, 1.0) else shift + factor * values


def _number(cell: Any, words: set[str], options: FileOptions, n: int, error: Any) -> float:
    if isinstance(cell, str):
        if cell.strip().lower() in words:
            return nan
        value = _parsed(cell, options)
        if value is None:
            raise error(n, f"expected a number, got {shown(cell)}")
    elif cell is None:
        return nan
    elif isinstance(cell, int | float | np.number) and not isinstance(cell, bool):
        try:
            value = float(cell)
        except OverflowError:
            value = np.inf
        if isnan(value):
            return nan
    else:
        raise error(n, f"expected a number, got {shown(cell)}")
    if not isfinite(value):
        raise error(n, f"expected a finite number, got {shown(cell)}")
    return value


def _text(cell: Any, raw: Raw, n: int, role: str) -> str:
    """Return a cell as text: the number 3 and the text "3" name the same sensor."""
    if cell is None or (isinstance(cell, float) and isnan(cell)):
        return ""
    if isinstance(cell, bytes):
        cell = cell.decode("utf-8", "backslashreplace")
    if isinstance(cell, bool) or not isinstance(cell, str | int | float | np.number):
        raise _place(raw, role)(n, f"expected a text, got {shown(cell)}")
    text = str(cell).strip()
    if not text.isprintable():
        raise _place(raw, role)(n, f"expected a text that can be printed, got {shown(cell)}")
    return text


def _refuse_nonsense(table: Table) -> None:
    """Raise ReadingsError for a number that its role cannot have."""
    for role, (low, high) in LIMITS.items():
        column = table.number(role)
        _refuse(table, role, (column < low) | (column > high), f"expected degrees from {low:g} to {high:g}")
    sd, entry = table.number("sd"), table.number("entry")
    _refuse(table, "sd", sd <= 0.0, "expected a standard deviation above 0")
    _refuse(table, "span", table.number("span") < 0.0, "expected a time from 0")
    _refuse(table, "entry", (entry < 0.0) | (entry % 1.0 > 0.0) | (entry > 1e15), "expected a whole number from 0")
    late = table.number("arrives") < table.number("time")
    _refuse(table, "arrives", late, "a reading cannot arrive before it is taken")


def _refuse(table: Table, role: str, wrong: Any, text: str) -> None:
    if wrong.any():
        row = int(np.argmax(wrong))
        raise table.error(f"{text}, got {table.number(role)[row]:g}", row, role)
