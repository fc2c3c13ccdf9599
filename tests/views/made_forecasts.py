"""What ``forecast.nc`` would hold of a run: a cloud that every lead time moves to the east."""

from __future__ import annotations

import numpy as np
import xarray as xr

ISSUES, LEADS, THRESHOLDS, QUANTILES = [10.0, 40.0], [0.0, 30.0], [0.01, 0.1], [0.1, 0.5]


def forecasts(run, issues=ISSUES):
    """Return what ``forecast.nc`` would hold: the gas is in the west, and every lead time moves it to the east."""
    x = run["node_x"].values
    sizes = (len(issues), len(LEADS), len(THRESHOLDS), x.size)
    chance = np.zeros(sizes)
    for k, issue in enumerate(issues):
        for j, lead in enumerate(LEADS):
            edge = 100.0 + 2.0 * issue + 5.0 * lead
            chance[k, j] = np.clip([(edge - x) / 100.0, (edge - x - 80.0) / 100.0], 0.0, 1.0)
    # Areas: near is reached for sure, far not at all.
    reach = np.zeros((len(issues), 2, 2))
    reach[..., 0] = 1.0
    arrival = np.full((len(issues), 2, 2, 2), np.nan)
    arrival[..., 0] = np.array(QUANTILES) * 10.0
    one = {"units": "1"}
    return xr.Dataset(
        {
            "exceedance_probability": (("issue", "lead", "threshold", "node"), chance.astype("f4"), one),
            "area_reach_probability": (("issue", "threshold", "area"), reach, one),
            "area_arrival_time": (("issue", "threshold", "quantile", "area"), arrival, {"units": "s"}),
            "area_name": ("area", np.array(["near & <b>dear</b>", "far"], object)),
        },
        {
            "issue": ("issue", np.array(issues), {"units": "s"}),
            "lead": ("lead", LEADS, {"units": "s"}),
            "threshold": ("threshold", THRESHOLDS, one),
            "quantile": ("quantile", QUANTILES, one),
        },
        {"horizon": 60.0, "scored_variable": "concentration"},
    )
