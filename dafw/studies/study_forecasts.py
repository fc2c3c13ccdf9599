"""The forecasts of a study of many runs, judged together: for each configuration by lead time, with 95 % intervals.

The numbers of a seed are means over its issues; seeds are independent, so the intervals are bootstraps over seeds.
Runs that failed or that made no forecasts are left out and counted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from xarray import Dataset

from dafw.core.errors import DafwError
from dafw.core.forecasts.forecast_file import FILE
from dafw.core.space import Array
from dafw.studies.forecast_scores import BINS, RIVALS, bin_of, kept_scores
from dafw.studies.many_runs import run_folder
from dafw.studies.side_by_side import status_of_run
from dafw.studies.study_files import ManyRuns
from dafw.studies.study_statistics import bootstrap_interval, exact_interval

BY_LEAD: dict[str, Callable[..., Any]] = {"brier": np.mean, "contour_distance": np.median, "arrival_error": np.mean}
"""Scores by lead time, and what is made of them over the seeds. A contour distance may be infinite."""


def study_forecasts(study: ManyRuns, folder: Path) -> dict[str, dict[str, Any]]:
    """Return what is said of the forecasts of each configuration, by its name; without forecasts there is none."""
    found = {}
    for one in study.configurations:
        runs = [scores for seed in study.seeds if (scores := _scores(run_folder(folder, one, seed))) is not None]
        if runs:
            found[one.name] = judged(runs, one.name)
    return found


def _scores(folder: Path) -> Dataset | None:
    """Return the scores of a run; None if it is not complete, or its forecasts have no truth."""
    if status_of_run(folder) != "complete" or not (folder / FILE).is_file():
        return None
    try:
        return kept_scores(folder)
    except DafwError:
        return None


def judged(runs: Sequence[Dataset], name: str) -> dict[str, Any]:
    """Return the statistics of several runs' scores (``forecast_scores.scores_of``), ready for JSON."""
    scores = xarray.concat(list(runs), "seed", join="outer", data_vars="all", coords="minimal", compat="override")
    told: dict[str, Any] = {
        "n_runs": len(runs),
        "issues": scores["issue"].values.tolist(),
        "horizon": float(scores.attrs["horizon"]),
        "variable": str(scores.attrs["scored_variable"]),
        "by_lead": list(_by_lead(scores, name)),
        "by_issue": list(_by_issue(scores)),
        "reliability": list(_reliability(scores)),
    }
    return told | ({"areas": list(_areas(scores, name))} if "area_happened" in scores else {})


def _by_lead(scores: Dataset, name: str) -> Iterator[dict[str, Any]]:
    """Yield a row for each threshold and lead time: every score of every compared forecast."""
    for limit in scores["threshold"].values:
        for lead in scores["lead"].values:
            one = scores.sel(threshold=limit, lead=lead)
            row: dict[str, Any] = {"threshold": float(limit), "lead": float(lead)}
            for score, statistic in BY_LEAD.items():
                for rival in _rivals(scores, score):
                    key = f"{score}_{rival}"
                    values = _of_seeds(one[key].values, median=statistic is np.median)
                    row[key] = _finite(statistic(values)) if values.size else None
                    if values.size > 1:
                        row[f"{key}_interval"] = bootstrap_interval(values, statistic, f"{name} {key} {limit} {lead}")
            yield row


def _by_issue(scores: Dataset) -> Iterator[dict[str, Any]]:
    """Yield the mean Brier scores over the seeds for each threshold, lead time and issue."""
    means = {rival: scores[f"brier_{rival}"].mean("seed") for rival in _rivals(scores, "brier")}
    for limit in scores["threshold"].values:
        for lead in scores["lead"].values:
            for issue in scores["issue"].values:
                place = {"threshold": limit, "lead": lead, "issue": issue}
                row = {name: float(value) for name, value in place.items()}
                yield row | {f"brier_{rival}": _finite(mean.sel(place)) for rival, mean in means.items()}


def _of_seeds(values: Array, median: bool) -> Array:
    """Return one number for each seed that has any, from values (seed, issue): their mean or their median."""
    kept = [one[~np.isnan(one)] for one in values]
    return np.array([np.median(one) if median else one.mean() for one in kept if one.size])


def _reliability(scores: Dataset) -> Iterator[dict[str, Any]]:
    """Yield the reliability diagram of each threshold and lead time: share of the site, promised, happened by bin."""
    for limit in scores["threshold"].values:
        for lead in scores["lead"].values:
            one = scores.sel(threshold=limit, lead=lead)
            share, promised, happened = (
                one[f"reliability_{part}"].sum(("seed", "issue")).values for part in ("share", "promised", "happened")
            )
            yield {
                "threshold": float(limit),
                "lead": float(lead),
                "share": (share / share.sum()).tolist(),
                "promised": _ratios(promised, share),
                "happened": _ratios(happened, share),
            }


def _areas(scores: Dataset, name: str) -> Iterator[dict[str, Any]]:
    """Yield, for each threshold, what was promised of the areas and what happened: by bin, by area, and scores."""
    names = scores["area_name"].isel(seed=0).values
    for limit in scores["threshold"].values:
        one = scores.sel(threshold=limit)
        happened = one["area_happened"].values
        promised = one["area_promised_belief"].values
        known = np.isfinite(promised)
        bins = bin_of(np.where(known, promised, 0.0))
        inside = [known & (bins == number) for number in range(BINS + 1)]
        row: dict[str, Any] = {
            "threshold": float(limit),
            "n": [int(here.sum()) for here in inside],
            "promised": [_finite(promised[here].mean()) if here.any() else None for here in inside],
            "happened": [_finite(happened[here].mean()) if here.any() else None for here in inside],
            "happened_interval": [
                exact_interval(int(happened[here].sum()), int(here.sum())) if here.any() else None for here in inside
            ],
        }
        for score in ("area_brier", "area_arrival_crps"):
            for rival in _rivals(scores, score):
                values = np.nanmean(one[f"{score}_{rival}"].values, axis=(1, 2))
                row[f"{score}_{rival}"] = _finite(values.mean())
                if values.size > 1:
                    address = f"{name} {score} {rival} {limit}"
                    row[f"{score}_{rival}_interval"] = bootstrap_interval(values, np.mean, address)
        row["by_area"] = [
            {
                "name": str(area),
                "promised": _finite(np.nanmean(promised[..., number])),
                "happened": _finite(np.nanmean(happened[..., number])),
            }
            for number, area in enumerate(names)
        ]
        yield row


def _rivals(scores: Dataset, score: str) -> list[str]:
    return [rival for rival in RIVALS if f"{score}_{rival}" in scores]


def _ratios(values: Array, shares: Array) -> list[float | None]:
    return [_finite(value / share) if share > 0.0 else None for value, share in zip(values, shares, strict=True)]


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
