"""What a page shows of many runs: the table with intervals, ERR over time with bands, every seed as a point."""

from __future__ import annotations

import json
from collections.abc import Mapping
from os.path import relpath
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import xarray
from xarray import Dataset

from dafw.core.errors import RunError
from dafw.studies.study_table import cells
from dafw.views.report import NAME
from dafw.views.report_curves import numbers
from dafw.views.studies import BEYOND, EMPTY, HEADROOM, quantiles_over_seeds, times_of

BANDS = {"half of the seeds": (0.25, 0.75), "nine in ten": (0.05, 0.95)}


def results_of_study(folder: Path) -> tuple[Dataset, dict[str, Any]]:
    """Return the results and the summary of a study, as ``dafw study`` wrote them; raises RunError if it did not."""
    try:
        with xarray.open_dataset(folder / "study.nc", decode_times=False) as opened:
            results = opened.load()
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RunError(f"{folder}: cannot be read as a study ({' '.join(str(error).split())})") from error
    if not isinstance(summary, dict) or "configurations" not in summary or "configuration" not in results.dims:
        raise RunError(f"{folder}: is not what 'dafw study' leaves")
    return results, summary


def page_of_study(
    results: Dataset, summary: Mapping[str, Any], folder: Path, beside: Path, command: str
) -> dict[str, Any]:
    """Return everything that a page shows of the results of the runs in ``folder`` (``outcomes.gather``).

    ``beside`` is the folder of the page, from which it leads to the pages of runs; ``command`` repeats all of it.
    """
    seeds = [int(seed) for seed in results["seed"].values]
    missing = summary["n_runs"] - summary["n_complete"] - summary["n_failed"]
    counts = {"runs": summary["n_runs"], "failed": summary["n_failed"], "missing": missing}
    told = ", ".join(f"{count} {name}" for name, count in counts.items() if count or name == "runs")
    rows = cells(summary)
    has_err = "err" in results and bool(np.isfinite(results["err_final"].values).any())
    return {
        "kind": "study",
        "title": str(summary.get("title") or summary.get("name") or "study"),
        "subtitle": f"{summary.get('name', '')} · {_ranges(seeds)} · {told}",
        "table": {"headings": rows[0], "rows": rows[1:]},
        "time": {"values": numbers(_time(results)), "units": "s"},
        "curves": _curves(results) if has_err else [],
        "seeds": _points(results, folder, beside) if has_err else None,
        "failed": [
            [f"{one['configuration']}, seed {one['seed']}", str(one["error"])] for one in summary.get("failed", [])
        ],
        "words": {"command": command, "tables": [], "configuration": "", "status": str(summary.get("status", ""))},
    }


def _time(results: Dataset) -> np.ndarray:
    """Return the times of all charts; rows of runs with other time steps have no common time."""
    if "time" in results.coords:
        return results["time"].values
    return times_of(results.isel(configuration=0))


def _curves(results: Dataset) -> list[dict[str, Any]]:
    """Return the chart of ERR of each configuration, all with one scale."""
    charts, top = [], 1.06 * EMPTY
    for name in map(str, results["configuration"].values):
        one = results.sel(configuration=name)
        probabilities = sorted({0.5, *(end for pair in BANDS.values() for end in pair)})
        found = dict(zip(probabilities, quantiles_over_seeds(one, "err", tuple(probabilities)), strict=True))
        lines = [_line("mean", "median", found[0.5])]
        free = quantiles_over_seeds(one, "err_free", (0.5,))[0] if "err_free" in one else np.empty(0)
        if (free < BEYOND).any():
            lines.append(_line("free", "free run, median", free))
        ceiling = HEADROOM * max(EMPTY, _largest(free))
        top = max(top, min(ceiling, 1.05 * max(_largest(found[0.75]), _largest(free))))
        charts.append(
            {
                "id": f"err {name}",
                "title": name,
                "units": "%",
                "lines": lines,
                "bands": [
                    {"label": label, "low": numbers(found[low]), "high": numbers(found[high])}
                    for label, (low, high) in BANDS.items()
                ],
                "reference": {"value": EMPTY, "label": "empty map"},
                "floor": 0.0,
                "log": True,
            }
        )
    return [chart | {"top": top} for chart in charts]


def _points(results: Dataset, folder: Path, beside: Path) -> dict[str, Any]:
    """Return ERR at the end of every run that ended, with the address of its page if there is one."""
    groups = []
    for name in map(str, results["configuration"].values):
        one = results.sel(configuration=name)
        points = []
        for seed, status, err, place in zip(
            one["seed"].values, one["status"].values, one["err_final"].values, one["folder"].values, strict=True
        ):
            if status not in ("complete", "failed"):
                continue
            page = folder / str(place) / NAME
            address = quote(Path(relpath(page, beside)).as_posix()) if page.is_file() else ""
            known = float(err) if np.isfinite(err) else None
            points.append({"seed": int(seed), "status": str(status), "err": known, "page": address})
        groups.append({"name": name, "points": points})
    return {"groups": groups, "success": float(results.attrs["success_below_percent"])}


def _line(role: str, label: str, values: np.ndarray) -> dict[str, Any]:
    """Return a line; where it stands for failed runs, which are larger than any number, it is missing."""
    return {"role": role, "label": label, "values": numbers(np.where(values < BEYOND / 10.0, values, np.nan))}


def _largest(values: np.ndarray) -> float:
    known = values[np.isfinite(values) & (values < BEYOND / 10.0)]
    return float(known.max()) if known.size else 0.0


def _ranges(seeds: list[int]) -> str:
    """Return seeds in words: ``seeds 0 to 9``, ``seeds 1, 3, 5``."""
    if len(seeds) == 1:
        return f"seed {seeds[0]}"
    if seeds == list(range(seeds[0], seeds[-1] + 1)):
        return f"seeds {seeds[0]} to {seeds[-1]}"
    shown = ", ".join(map(str, seeds[:8]))
    return f"seeds {shown}" + (f" and {len(seeds) - 8} more" if len(seeds) > 8 else "")
