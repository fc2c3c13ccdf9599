"""Writing the results of a study of many runs: ``study.nc``, ``summary.json``, tables and figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from dafw.core.files import write_atomically
from dafw.studies.forecast_table import forecast_tables
from dafw.studies.outcomes import gather, write_study
from dafw.studies.study_files import ManyRuns
from dafw.studies.study_forecasts import study_forecasts
from dafw.studies.study_statistics import summarised
from dafw.studies.study_table import table


def write_results(study: ManyRuns, folder: Path, *, pictures: bool = True) -> dict[str, Any]:
    """Write the results of the runs that there are, and return the summary with its ``table``."""
    results = gather(study, folder)
    write_study(results, folder / "study.nc")
    summary = summarised(results)
    forecasts = study_forecasts(study, folder)
    for one in summary["configurations"]:
        one |= {"forecasts": forecasts[one["name"]]} if one["name"] in forecasts else {}
    write_atomically(folder / "summary.json", json.dumps(summary, indent=2) + "\n")
    text = table(summary)
    write_atomically(folder / "table.md", text)
    if forecasts:
        write_atomically(folder / "forecasts.md", forecast_tables(forecasts))
    if pictures and forecasts:
        from dafw.views.forecasts import draw_forecasts

        draw_forecasts(forecasts, folder / "figures")
    if pictures and summary["n_complete"]:
        from dafw.views.studies import draw_study

        draw_study(results, folder)
    return summary | {"table": text}
