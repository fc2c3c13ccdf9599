"""Readings in CSV: a line of column names, then one line for each reading, in UTF-8."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from dafw.plugins.readings.files.cells import Raw, find_columns, made, without_unit
from dafw.plugins.readings.files.options import FileOptions
from dafw.plugins.readings.files.table import NUMBERS, TEXTS, Table, about, shown, written_date
from dafw.plugins.readings.files.times import parsed_date

DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|"}


def read_csv(path: Path, options: FileOptions) -> Table:
    """Return the readings of a file; raises ReadingsError, which names the line and the column."""
    name = str(path)
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        wrong = error.object[: error.start].count(b"\n") + 1
        raise about(name, "expected text in UTF-8, got something else", "line", wrong) from None
    lines = _lines(text, options, name)
    headers, body = lines[0][1], lines[1:]
    places = find_columns(headers, options.columns, name)
    rows, cells = [], []
    for number, line in body:
        if len(line) > len(headers) and any(cell.strip() for cell in line[len(headers) :]):
            raise about(name, f"{len(line)} cells, but there are {len(headers)} columns", "line", number)
        if len(line) < len(headers):
            raise about(name, f"{len(line)} cells, expected {len(headers)}, one for each column", "line", number)
        rows.append(number)
        cells.append(line)
    units = {role: unit for role, place in places.items() if (unit := without_unit(headers[place])[1])}
    raw = Raw(
        path=name,
        word="line",
        rows=rows,
        cells={role: [line[place] for line in cells] for role, place in places.items()},
        names={role: headers[place].strip() for role, place in places.items()},
        units=units,
        others=tuple(header.strip() for n, header in enumerate(headers) if n not in places.values()),
    )
    table = made(raw, options)
    return table if options.date_line is None else _dated(table, text, options)


def _dated(table: Table, text: str, options: FileOptions) -> Table:
    """Return a table in seconds with the date that stands in a line of the file; raises ReadingsError."""
    number = options.date_line or 1
    lines = text.splitlines()
    if table.epoch is not None:
        raise table.error("date_line says from which date seconds count, and its times are dates already")
    line = lines[number - 1] if number <= len(lines) else ""
    # Some instruments write " 9.5" for the seconds "09.5".
    moment = parsed_date(re.sub(r":\s+", ":0", line), options.date_format)
    if moment is None:
        form = "ISO 8601" if options.date_format is None else repr(options.date_format)
        raise about(table.path, f"expected a date as {form}, got {shown(line)}", "line", number)
    return replace(table, epoch=moment)


def _lines(text: str, options: FileOptions, name: str) -> list[tuple[int, list[str]]]:
    """Return the numbers of the lines that are not empty, and their cells; the line of column names first."""
    stream = io.StringIO(text, newline="")
    for _ in range(options.skip):
        stream.readline()
    position = stream.tell()
    first = next((line for line in stream if line.strip()), "")
    stream.seek(position)
    found = []
    try:
        for number, line in _split(stream, first, options):
            if len(line) > 1 or any(cell.strip() for cell in line):
                found.append((options.skip + number, line))
    except csv.Error as error:
        number = options.skip + text.count("\n", position, stream.tell())
        raise about(name, f"is not CSV ({error})", "line", number) from None
    if not found:
        skipped = f" after the {options.skip} lines that are skipped" if options.skip else ""
        raise about(name, f"is empty{skipped}, expected a line of column names")
    return found


def _split(stream: io.StringIO, first: str, options: FileOptions) -> Iterator[tuple[int, list[str]]]:
    """Yield the number and the cells of every line."""
    if options.delimiter == "space":
        for number, text in enumerate(stream, 1):
            yield number, text.split()
        return
    delimiter = DELIMITERS.get(options.delimiter) or max(DELIMITERS.values(), key=first.count)
    reader = csv.reader(stream, delimiter=delimiter, strict=True, skipinitialspace=delimiter != "\t")
    begun = 1
    for line in reader:
        yield begun, line
        begun = reader.line_num + 1


def write_csv(table: Table, path: Path) -> None:
    """Write a table; reading the file gives the same table, to the last bit."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\n")
    roles = [role for role in (*NUMBERS, *TEXTS) if role in table.numbers or role in table.texts]
    writer.writerow(roles)
    columns = [_written(table, role) for role in roles]
    writer.writerows(zip(*columns, strict=True))
    path.write_text(stream.getvalue(), encoding="utf-8", newline="")


def _written(table: Table, role: str) -> list[str]:
    """Return a column as texts from which the same numbers are read: Python writes as many digits as that needs."""
    if role in TEXTS:
        return list(table.texts[role])
    column = table.numbers[role].tolist()
    if role in ("time", "arrives") and table.epoch is not None:
        return ["" if np.isnan(value) else written_date(table.epoch, value) for value in column]
    if role == "entry":
        return ["" if np.isnan(value) else f"{value:.0f}" for value in column]
    return ["" if np.isnan(value) else repr(value) for value in column]
