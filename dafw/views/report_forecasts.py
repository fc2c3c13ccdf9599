"""What a page shows of forecasts: how probable it is that thresholds are exceeded, and when areas are reached."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dafw.core.errors import RunError
from dafw.core.forecasts.forecast_file import FILE, open_forecasts
from dafw.views.contents import has_map
from dafw.views.report_curves import numbers
from dafw.views.report_fields import kept_rows, packed

if TYPE_CHECKING:
    from xarray import Dataset

LARGEST = 2_500_000
"""Bytes that the maps of all forecasts may take, in base64: with all fields (report_fields) a page is below 15 MB."""


def forecasts_of(run: Dataset, folder: Path, largest: int = LARGEST) -> dict[str, Any] | None:
    """Return the forecasts in a run's folder; None if there are none, or nothing in the run has a place on a mesh.

    The maps are probabilities (issue * lead * threshold, node), packed in 8 bits. If they take more than ``largest``
    bytes, every second, fourth, ... forecast is kept, and the last one. Raises RunError if they cannot be read, such as
    in a moment in which a run writes them.
    """
    if not ((folder / FILE).is_file() and has_map(run)):
        return None
    with open_forecasts(folder) as opened:
        names = ["exceedance_probability", "threshold", "lead", "quantile", "issue"]
        if "area_name" in opened.variables:
            names += ["area_name", "area_reach_probability", "area_arrival_time"]
        try:
            found = opened[names].load()
        except (OSError, ValueError, RuntimeError, LookupError) as error:
            reason = " ".join(str(error).split())
            raise RunError(f"{folder / FILE}: cannot be read as forecasts ({reason})") from error
    count = found.sizes["issue"]
    if not count or found.sizes["node"] != run.sizes["node"]:
        return None
    every, maps = 1, _packed(found, range(count))
    while len(maps["data"]) > largest and every < count:
        every *= 2
        maps = _packed(found, kept_rows(count, every))
    kept = found.isel(issue=kept_rows(count, every))
    return {
        "issues": numbers(kept["issue"].values),
        "every": every,
        "leads": numbers(found["lead"].values),
        "thresholds": numbers(found["threshold"].values),
        "units": str(found["threshold"].attrs.get("units", "1")),
        "horizon": float(found.attrs["horizon"]),
        "maps": maps,
        "areas": _areas(kept),
    }


def _packed(found: Dataset, issues: Any) -> dict[str, Any]:
    dims = ("issue", "lead", "threshold", "node")
    values = found["exceedance_probability"].isel(issue=list(issues)).transpose(*dims).values
    return packed(values.reshape(-1, found.sizes["node"]), 8)


def _areas(found: Dataset) -> dict[str, Any] | None:
    """Return, by issue, threshold and area: the probability of being reached; and quantiles of the time of arrival."""
    if "area_name" not in found:
        return None
    chances = found["area_reach_probability"].transpose("issue", "threshold", "area").values
    times = found["area_arrival_time"].transpose("issue", "threshold", "area", "quantile").values
    return {
        "names": [str(name) for name in found["area_name"].values],
        "quantiles": numbers(np.asarray(found["quantile"].values)),
        "probability": numbers(chances),
        "arrival": numbers(times),
    }
