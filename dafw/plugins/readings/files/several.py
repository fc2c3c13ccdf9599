"""Several files of readings as one table: a file a sensor, whose paths a pattern with one ``*`` names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from datetime import datetime
from glob import escape, glob
from pathlib import Path

import numpy as np

from dafw.plugins.readings.files.table import NUMBERS, TEXTS, Table, about


def is_pattern(file: str) -> bool:
    """Return whether an option ``file`` names several files."""
    return "*" in file


def files_of(pattern: str) -> dict[str, Path]:
    """Return by sensor the files that a path with one ``*`` names, in alphabetical order.

    The sensor is what the ``*`` stands for: ``beam*.csv`` names ``beam1.csv`` of the sensor ``1``. Raises ReadingsError
    for more than one ``*``, and if there is no such file.
    """
    if pattern.count("*") > 1:
        raise about(pattern, "expected one *, which stands for the name of the sensor")
    before, after = pattern.split("*")
    before = str(Path(before + "x").expanduser())[:-1]
    names = sorted(glob(f"{escape(before)}*{escape(after)}"))  # noqa: PTH207  # absolute or not, as it was given
    found = {name[len(before) : len(name) - len(after)]: Path(name) for name in names}
    files = {sensor: path for sensor, path in found.items() if path.is_file()}
    if not files:
        raise about(pattern, "no such files")
    return files


def read_several(pattern: str, read: Callable[[Path], Table]) -> Table:
    """Return the rows of all files; where a file names no sensors, its rows get the sensor that its path names."""
    tables = []
    for sensor, path in files_of(pattern).items():
        table = read(path)
        if "sensor" not in table.texts:
            table = replace(table, texts={**table.texts, "sensor": np.full(len(table), sensor, dtype=object)})
        tables.append(table)
    return joined(pattern, tables)


def joined(pattern: str, tables: Sequence[Table]) -> Table:
    """Return tables, which may begin at different dates, as one; raises ReadingsError if only some have dates."""
    epochs = [table.epoch for table in tables]
    known = [epoch for epoch in epochs if epoch is not None]
    if known and len(known) < len(tables):
        without = tables[epochs.index(None)]
        raise about(without.path, "its times are seconds, and those of other files of the pattern are dates")
    first = min(known, default=None)
    columns = [role for role in (*NUMBERS, *TEXTS) if any(role in one.numbers or role in one.texts for one in tables)]
    return replace(
        tables[0],
        path=pattern,
        rows=np.concatenate([table.rows for table in tables]),
        numbers={
            role: np.concatenate([table.number(role) + _later(table, role, first) for table in tables])
            for role in columns
            if role in NUMBERS
        },
        texts={role: np.concatenate([table.text(role) for table in tables]) for role in columns if role in TEXTS},
        epoch=first,
    )


def _later(table: Table, role: str, first: datetime | None) -> float:
    """Return by how many seconds the times of a table begin after ``first``; 0 for other columns."""
    if first is None or table.epoch is None or role not in ("time", "arrives"):
        return 0.0
    return (table.epoch - first).total_seconds()
