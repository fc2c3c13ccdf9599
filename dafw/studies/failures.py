"""A table of the runs of a folder that are not complete: where each stopped, and why."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from dafw.core.runs import summary_of

PLACE = re.compile(r"at t = \S+ s, phase '[^']*': ")
WIDEST = 100
"""How many characters of a reason are shown."""


def counted(folders: Sequence[Path | None]) -> str:
    """Return how many runs there are of each status, in words; None: a run that has no folder yet."""
    found = Counter(_status(folder) for folder in folders)
    told = ", ".join(f"{number} {status}" for status, number in found.items())
    return f"{len(folders)} runs: {told}"


def failure_table(runs: Sequence[tuple[str, Path | None]]) -> str:
    """Return a table of the named runs that are not complete: status, cycles, time, phase and reason; '' if all are."""
    rows = [("run", "status", "cycles", "time", "phase", "why")]
    for name, folder in runs:
        if (status := _status(folder)) == "complete":
            continue
        summary = {} if folder is None else summary_of(folder)
        place = summary.get("failed_at") or {}
        time = place.get("time")
        why = PLACE.sub("", str(summary.get("error", ""))).split("; ")[0]
        rows.append(
            (
                name,
                status,
                f"{summary.get('cycles', 0)} of {summary.get('cycles_wanted', '?')}",
                "" if time is None else f"{time:g} s",
                str(place.get("phase") or ""),
                why if len(why) <= WIDEST else f"{why[:WIDEST]}...",
            )
        )
    if len(rows) == 1:
        return ""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )


def _status(folder: Path | None) -> str:
    return "missing" if folder is None else str(summary_of(folder).get("status", "missing"))
