"""The forecasts of a study as tables in Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dafw.studies.forecast_scores import RIVALS
from dafw.studies.study_table import aligned

HEADINGS = {"belief": "belief", "free": "free run", "now": "stays as it is now", "released": "stays where released"}
SCORES = {
    "brier": ("Brier score", "{:.4f}"),
    "contour_distance": ("contour distance (m)", "{:.1f}"),
    "arrival_error": ("error of arrival (s)", "{:.1f}"),
}
OF_AREAS = {
    "area_brier": ("areas: Brier score of being reached", "{:.3f}"),
    "area_arrival_crps": ("areas: CRPS of the time of arrival (s)", "{:.1f}"),
}


def forecast_tables(forecasts: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the tables of all configurations, from ``study_forecasts``; intervals in brackets are the bootstrap's."""
    return "\n".join(f"## {name}\n\n{forecast_table(told)}" for name, told in forecasts.items())


def forecast_table(told: Mapping[str, Any]) -> str:
    """Return one configuration's table: a row for each score, threshold and lead time."""
    shown = [rival for rival in RIVALS if any(f"brier_{rival}" in row for row in told["by_lead"])]
    rows = [["score", "threshold", "lead time", *(HEADINGS[rival] for rival in shown)]]
    for score, (title, form) in SCORES.items():
        for row in told["by_lead"]:
            cells = [_cell(row, f"{score}_{rival}", form) for rival in shown]
            rows.append([title, f"{row['threshold']:g}", f"{row['lead']:g} s", *cells])
    for score, (title, form) in OF_AREAS.items():
        for row in told.get("areas", []):
            cells = [_cell(row, f"{score}_{rival}", form) for rival in shown]
            rows.append([title, f"{row['threshold']:g}", f"0 to {told['horizon']:g} s", *cells])
    return aligned(rows)


def _cell(row: Mapping[str, Any], key: str, form: str) -> str:
    """Return a number with its interval; a dash where there is none, or where it is infinite."""
    if row.get(key) is None:
        return "-"
    interval = row.get(f"{key}_interval")
    text = form.format(row[key])
    if interval is None:
        return text
    low, high = (form.format(end) if end is not None else "-" for end in interval)
    return f"{text} ({low} to {high})"
