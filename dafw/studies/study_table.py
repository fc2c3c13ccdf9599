"""The table of a study, in Markdown that is also readable on a terminal: one row for each configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

COLUMNS = {
    "success_rate": ("success", "rate"),
    "better_than_free": ("better than free run", "rate"),
    "median_err": ("median ERR", "%"),
    "worst_err": ("worst ERR", "%"),
    "median_err_ratio": ("ERR / free run's", "2"),
    "floor": ("floor", "%"),
    "median_err_over_floor": ("ERR / floor", "2"),
    "wind_found_rate": ("wind found", "rate"),
    "wind_found_rate_2": ("wind within 2 %", "rate"),
    "median_time_to_50": ("time to success", "s"),
    "coverage_wind_speed": ("speed in its 90 %", "rate"),
    "coverage_wind_direction": ("direction in its 90 %", "rate"),
    "median_amount_ratio": ("gas / truth's", "2"),
    "seconds_per_run": ("per run", "s"),
    "real_time_factor": ("real time", "x"),
}
"""The columns after the name and the number of seeds: a heading, and how its numbers are written."""


def table(summary: Mapping[str, Any]) -> str:
    """Return a study's table from its summary; columns in which no configuration has a number are left out.

    Intervals in brackets are the bootstrap's, those of rates the exact ones.
    """
    return aligned(cells(summary))


def cells(summary: Mapping[str, Any]) -> list[list[str]]:
    """Return the rows of a study's table, the first of them the headings, as texts."""
    configurations = summary["configurations"]
    shown = [key for key in COLUMNS if any(one.get(key) is not None for one in configurations)]
    rows = [["configuration", "seeds", *(COLUMNS[key][0] for key in shown)]]
    for one in configurations:
        failed = f" ({one['n_failed']} failed)" if one["n_failed"] else ""
        rows.append([one["name"], f"{one['n_seeds']}{failed}", *(_cell(one, key) for key in shown)])
    return rows


def _cell(one: Mapping[str, Any], key: str) -> str:
    form = COLUMNS[key][1]
    interval = one["exact_intervals" if form == "rate" else "intervals"].get(key)
    if one.get(key) is None:
        return "-"
    text = _written(one[key], form)
    if interval is None or key in ("seconds_per_run", "real_time_factor"):
        return text
    bare = [_written(end, form).removesuffix(" %").removesuffix(" s") if end is not None else "-" for end in interval]
    return f"{text} ({bare[0]} to {bare[1]})"


def _written(value: float, form: str) -> str:
    match form:
        case "rate":
            return f"{100.0 * value:.0f} %"
        case "%":
            return f"{value:.1f} %"
        case "s":
            return f"{value:.3g} s" if value < 1000.0 else f"{value:.0f} s"
        case "x":
            return f"{value:.3g} x" if value < 1000.0 else f"{value:.0f} x"
    return f"{value:.2f}"


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Return rows, the first of them the headings, as a Markdown table whose columns are aligned."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = [
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |" for row in rows
    ]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(lines) + "\n"
