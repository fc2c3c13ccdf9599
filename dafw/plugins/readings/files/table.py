"""Readings of a file as a table: a row for each reading, a column for each role, whatever the format was."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dafw.core.errors import ReadingsError
from dafw.core.space import Array, IntArray

NUMBERS = ("time", "x", "y", "lon", "lat", "entry", "value", "sd", "span", "arrives")
"""Roles of columns that hold numbers."""
TEXTS = ("unit", "sensor")
"""Roles of columns that hold texts."""
PLACES = {"metres": ("x", "y"), "degrees": ("lon", "lat"), "entry": ("entry",)}
"""The ways to say where a reading was taken, in the order in which they are preferred, and their columns."""
SHOWN = 40
"""Characters of a wrong cell that a message shows."""


def shown(value: Any) -> str:
    """Return a value for a message, cut if it is long."""
    text = repr(value)
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 3]}..."


@dataclass(frozen=True, eq=False)
class Table:
    """Readings as they stand in a file.

    ``numbers`` (R,) by role, NaN where a number is missing; ``texts`` (R,) by role, "" where a text is missing. A role
    that the file does not have is absent. Times are in seconds, after ``epoch`` where the file has dates. ``rows`` (R,)
    are the numbers of the rows in the file, each of which is a ``word`` (a line, a feature, a row). ``names`` are the
    file's own names of the columns by role, ``others`` those of the columns that are not used.
    """

    path: str
    word: str
    rows: IntArray
    numbers: Mapping[str, Array]
    texts: Mapping[str, NDArray[np.object_]] = field(default_factory=dict)
    epoch: datetime | None = None
    names: Mapping[str, str] = field(default_factory=dict)
    others: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.rows)

    def number(self, role: str) -> Array:
        """Return a column of numbers (R,); all NaN if the file does not have it."""
        return self.numbers.get(role, np.full(len(self), np.nan))

    def text(self, role: str) -> NDArray[np.object_]:
        """Return a column of texts (R,); all empty if the file does not have it."""
        return self.texts.get(role, np.full(len(self), "", dtype=object))

    def chosen(self, rows: Any) -> Table:
        """Return the table of some of its rows, given by index or mask."""
        return replace(
            self,
            rows=self.rows[rows],
            numbers={role: column[rows] for role, column in self.numbers.items()},
            texts={role: column[rows] for role, column in self.texts.items()},
        )

    def changed(self, **numbers: Array) -> Table:
        """Return the table with other columns of numbers (R,)."""
        return replace(self, numbers={**self.numbers, **numbers})

    def place_kind(self, wanted: str = "auto") -> str | None:
        """Return how the file says where a reading was taken, a key of ``PLACES``; None: it does not.

        Raises ReadingsError if columns are missing: y beside x, or those of the ``wanted`` kind.
        """
        for kind, roles in PLACES.items():
            there = [role for role in roles if role in self.numbers]
            if (wanted == kind and not there) or (wanted in ("auto", kind) and 0 < len(there) < len(roles)):
                lacking = next(role for role in roles if role not in self.numbers)
                raise self.error(f"no column '{lacking}'" + (f" beside '{there[0]}'" if there else "") + self._listed())
            if there and wanted in ("auto", kind):
                return kind
        return None

    def _listed(self) -> str:
        return f" (there are: {', '.join([*self.names.values(), *self.others]) or 'none'})"

    def error(self, text: str, row: int | None = None, role: str | None = None) -> ReadingsError:
        """Return an error about the file, one of its rows (an index), and a column."""
        return about(
            self.path, text, self.word, None if row is None else int(self.rows[row]), self.names.get(role or "")
        )

    def date(self, seconds: float) -> str:
        """Return a time of the table in words: the date where there are dates, else seconds."""
        return f"{seconds:g} s" if self.epoch is None else written_date(self.epoch, seconds)


def about(
    path: str, text: str, word: str = "row", number: int | None = None, column: str | None = None
) -> ReadingsError:
    """Return an error that names the file, and the row and the column where they are known."""
    place = f"readings file {path}"
    place += "" if number is None else f", {word} {number}"
    place += "" if column is None else f", column {shown(column)}"
    return ReadingsError(f"{place}: {text}")


def written_date(epoch: datetime, seconds: float) -> str:
    """Return a time after the epoch in ISO 8601, UTC, to the microsecond."""
    try:
        moment = (epoch + timedelta(microseconds=round(seconds * 1e6))).astimezone(UTC)
    except (OverflowError, ValueError):  # beyond the years that dates have
        return f"{epoch.isoformat()} + {seconds:g} s"
    return moment.replace(tzinfo=None).isoformat() + "Z"
