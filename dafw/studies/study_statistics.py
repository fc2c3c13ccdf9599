"""The statistics of a study: for each configuration rates and medians over its seeds, with 95 % intervals.

A run that failed is counted: as no success, and in medians of ERR as larger than any number, so that a configuration
does not look better for the runs that it could not finish. A median that is not finite is None.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from xarray import Dataset

from dafw.core.rng import Streams
from dafw.core.space import Array

RESAMPLES = 4000
LEVEL = 0.95
"""Share of the resampled statistics that an interval holds."""
SEED = 20_240_611
"""Seed of the resampling: the same runs give the same intervals."""
NO_FLOOR = 0.1
"""A floor below this, in per cent, is that of a truth that the model can be: nothing is compared with it."""
CLOSE = {"wind_found_rate": (0.05, 5.0), "wind_found_rate_2": (0.02, 2.0)}
"""How near the last wind must be to the truth: its speed as a fraction, its direction in degrees."""

type Statistic = tuple[Any, Callable[..., Any], bool]
"""Values of the runs (n,), what is made of them along an axis, and whether it is a rate."""


def summarised(results: Dataset) -> dict[str, Any]:
    """Return the summary of a study from its results (``outcomes.gather``), ready for JSON."""
    configurations = [configuration_summary(results, str(name)) for name in results["configuration"].values]
    status = results["status"].values
    failed = [
        {
            "configuration": str(results["configuration"].values[row]),
            "seed": int(results["seed"].values[column]),
            "folder": str(results["folder"].values[row, column]),
            "error": str(results["error"].values[row, column]),
        }
        for row, column in np.argwhere(status == "failed")
    ]
    ended = np.isin(status, ("complete", "failed"))
    return {
        "status": "complete" if ended.all() else "interrupted",
        "name": results.attrs["study"],
        "title": results.attrs["title"],
        "seeds": [int(seed) for seed in results["seed"].values],
        "n_runs": int(status.size),
        "n_complete": int((status == "complete").sum()),
        "n_failed": len(failed),
        "success_below_percent": float(results.attrs["success_below_percent"]),
        "configurations": configurations,
        "failed": failed,
    }


def configuration_summary(results: Dataset, name: str) -> dict[str, Any]:
    """Return the statistics of one configuration; None where the runs do not have what a statistic needs."""
    one = results.sel(configuration=name)
    status = one["status"].values
    summary: dict[str, Any] = {
        "name": name,
        "overrides": str(one["overrides"].values),
        "n_seeds": int(np.isin(status, ("complete", "failed")).sum()),
        "n_failed": int((status == "failed").sum()),
        "n_missing": int(np.isin(status, ("missing", "interrupted")).sum()),
    }
    floor = float(one["floor"]) if "floor" in one else np.nan
    found: dict[str, float | None] = {"floor": _finite(floor)}
    intervals: dict[str, list[float | None]] = {}
    exact: dict[str, list[float]] = {}
    for key, (values, statistic, is_rate) in _statistics(one, float(results.attrs["success_below_percent"]), floor):
        found[key] = _finite(statistic(values, axis=0)) if values.size else None
        if values.size > 1 and not key.startswith("worst_"):  # resampling says nothing about an extreme
            intervals[key] = bootstrap_interval(values, statistic, f"{name} {key}")
        if values.size and is_rate:
            exact[key] = exact_interval(int(values.sum()), values.size)
    best = _of_seeds(one, "err_final")
    ranked = one["seed"].values[np.isfinite(best)][np.argsort(best[np.isfinite(best)], kind="stable")]
    ends = {"best_seed": int(ranked[0]), "worst_seed": int(ranked[-1])} if ranked.size else {}
    return summary | found | ends | {"intervals": intervals, "exact_intervals": exact}


def _statistics(one: Dataset, success: float, floor: float) -> Iterator[tuple[str, Statistic]]:
    """Yield the statistics of a configuration (dims seed, time) by their names, in the order of the summary.

    ``success`` and ``floor`` in per cent; the floor is NaN if there is none.
    """
    ended = np.isin(one["status"].values, ("complete", "failed"))
    complete = one["status"].values == "complete"
    nothing: Array = np.empty(0)

    def among_ended(values: Array) -> Array:
        """Return the values of the runs that ended, or nothing if the complete ones have no number."""
        if complete.any() and np.isnan(values[complete]).all():
            return nothing
        return np.where(np.isnan(values), np.inf, values)[ended]

    def known(values: Array) -> Array:
        """Return the numbers of the complete runs that have one."""
        return values[complete & np.isfinite(values)]

    final, free = _of_seeds(one, "err_final"), _of_seeds(one, "err_free_final")
    err, ratio = among_ended(final), among_ended(final / free)
    yield "success_rate", (err < success, np.mean, True)
    yield "better_than_free", (ratio < 1.0, np.mean, True)
    yield "median_err", (err, np.median, False)
    yield "worst_err", (err, np.max, False)
    yield "median_err_ratio", (ratio, np.median, False)
    yield "median_err_over_floor", (err / floor if floor >= NO_FLOOR else nothing, np.median, False)
    for name, (share, degrees) in CLOSE.items():
        speed = _of_seeds(one, "final_wind_speed_off") / _of_seeds(one, "final_wind_speed_truth")
        direction = np.degrees(_of_seeds(one, "final_wind_direction_off"))
        both = np.isfinite(speed + direction)
        found = (np.abs(speed) <= share) & (np.abs(direction) <= degrees) & both
        has_wind = both.any() or ("final_wind_speed_off" in one and not complete.any())
        yield name, (found[ended] if has_wind else nothing, np.mean, True)
    yield "median_time_to_50", (among_ended(_of_seeds(one, "time_to_success")), np.median, False)
    for variable in map(str, one.data_vars):
        if (parameter := variable.removesuffix("_inside")) != variable:
            inside = known(_of_seeds(one, variable)) > 0.0
            yield f"coverage_{parameter.removeprefix('final_')}", (inside, np.mean, True)
    amount = known(_of_seeds(one, "amount_ratio"))
    yield "median_amount_ratio", (amount, np.median, False)
    yield "worst_amount_off", (np.abs(amount - 1.0), np.max, False)
    yield "seconds_per_run", (known(_of_seeds(one, "seconds")), np.median, False)
    yield "model_seconds", (known(_of_seeds(one, "model_seconds")), np.median, False)
    factor = _of_seeds(one, "simulated_seconds") / _of_seeds(one, "cycle_seconds")
    yield "real_time_factor", (known(factor), np.median, False)


def bootstrap_interval(values: Array, statistic: Callable[..., Any], address: str) -> list[float | None]:
    """Return the percentile interval of a statistic of ``values`` (n,) over runs drawn with replacement.

    ``statistic(values, axis)`` works along an axis. ``address`` names the random stream. The ends are values that were
    drawn, not interpolated, as some may be infinite; those are None.
    """
    rng = Streams(SEED).generator(f"bootstrap {address}", 0)
    drawn = np.sort(statistic(values[rng.integers(values.size, size=(RESAMPLES, values.size))], axis=1))
    ends = np.floor(np.array([(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0]) * (RESAMPLES - 1) + 0.5).astype(int)
    return [_finite(drawn[end]) for end in ends]


def exact_interval(successes: int, runs: int) -> list[float]:
    """Return the interval of a rate by Clopper and Pearson, doi:10.2307/2331986; unlike a bootstrap it has a width
    also if all runs succeed, or none.

    ``scipy.stats.binomtest`` returns the same, but importing ``scipy.stats`` takes about two seconds.
    """
    from scipy.special import betaincinv

    tail = (1.0 - LEVEL) / 2.0
    low = betaincinv(successes, runs - successes + 1, tail) if successes else 0.0
    high = betaincinv(successes + 1, runs - successes, 1.0 - tail) if successes < runs else 1.0
    return [float(low), float(high)]


def _of_seeds(one: Dataset, name: str) -> Array:
    """Return a variable's numbers (seeds,); NaN if the runs do not have it."""
    return one[name].values.astype(np.float64) if name in one else np.full(one.sizes["seed"], np.nan)


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
