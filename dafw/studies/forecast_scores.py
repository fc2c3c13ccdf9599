"""Judging the forecasts of one run by its truth, which was run ahead, too.

The belief's forecast is compared with three simple ones: the free run; ``now``, the gas stays as the belief has it now;
``released``, it stays as the first belief has it at t = 0. All scores are by issue, lead time and threshold.
Means over the site are weighted by the area that belongs to a node.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from xarray import DataArray, Dataset

from dafw.core.accessor.scores import crps_of_errors
from dafw.core.domain import node_areas
from dafw.core.errors import RunError
from dafw.core.files import write_dataset
from dafw.core.forecasts.contours import contour_of
from dafw.core.forecasts.forecast_file import FILE, open_forecasts
from dafw.core.forecasts.plan import MEDIAN
from dafw.core.space import Array
from dafw.studies.contour_distance import contour_distance

KEPT = "forecast_scores.nc"
RIVALS = ("belief", "free", "now", "released")
"""The forecasts that are compared; a run without a free run lacks ``free``."""
BINS = 10
"""Intervals of promised probabilities in a reliability diagram: bin k holds those nearest to k / BINS."""
DIMS = ("issue", "lead", "threshold")
TITLES = {
    "brier": ("1", "Brier score of places"),
    "contour_distance": ("m", "mean distance of the threshold's contour from the truth's"),
    "arrival_error": ("s", "mean error of the time of arrival"),
    "reliability_share": ("1", "share of the site in a bin of promised probability"),
    "reliability_promised": ("1", "sum of what was promised in a bin"),
    "reliability_happened": ("1", "sum of what happened in a bin"),
    "area_happened": ("1", "whether an area was reached"),
    "area_promised": ("1", "promised probability that an area is reached"),
    "area_brier": ("1", "Brier score of areas"),
    "area_arrival_crps": ("s", "continuous ranked probability score of the time of arrival in an area"),
}
"""Units and names of the scores, without the forecast that is compared."""


@dataclass(frozen=True)
class Guess:
    """One of the compared forecasts, at m places (nodes or areas).

    chance   (issue, lead, threshold, m)  promised probability that the threshold is exceeded
    reach    (issue, threshold, m)        the same, at any time within the horizon
    arrival  (issue, threshold, m)        when it is first exceeded; the horizon if it is not: half of the probability
    field    (issue, lead, m)             the value that is exceeded with a probability of a half; None for areas
    """

    chance: Array
    reach: Array
    arrival: Array
    field: Array | None


def forecast_scores(path: str | Path) -> Dataset:
    """Return the scores of the forecasts in a run's folder, or in a ``forecast.nc``; docs/forecasts.md lists them.

    Raises RunError if there are no forecasts, or none that were verified.
    """
    with open_forecasts(path) as forecasts:
        return scores_of(forecasts.load(), str(path))


def kept_scores(folder: Path) -> Dataset:
    """Return the scores of a run as kept in its folder; they are computed anew if its forecasts are others since."""
    import xarray

    source, kept = (folder / FILE).stat(), folder / KEPT
    mark = f"{version('dafw')} {source.st_size} {source.st_mtime_ns}"
    if kept.is_file():
        with xarray.open_dataset(kept, engine="netcdf4", decode_times=False) as found:
            if found.attrs.get("of") == mark:
                return found.load()
    scores = forecast_scores(folder).assign_attrs(of=mark)
    write_dataset(kept, scores)
    return scores


def scores_of(forecasts: Dataset, where: str = "forecast.nc") -> Dataset:
    """Return the scores of an open ``forecast.nc``; raises RunError, which names ``where`` it is."""
    name = str(forecasts.attrs["scored_variable"])
    if f"{name}_truth" not in forecasts:
        raise RunError(f"{where}: there is no truth to judge the forecasts by (forecast.verify=true, and a twin)")
    truth = forecasts[f"{name}_truth"].values
    limits = forecasts["threshold"].values
    happened = truth[:, :, np.newaxis] > limits[:, np.newaxis]
    guesses, contours = guesses_of(forecasts, ""), _contours(forecasts, truth)
    shares = node_shares(forecasts)
    bins = (
        "bin",
        np.arange(BINS + 1) / BINS,
        {"units": "1", "long_name": "promised probability in the middle of a bin"},
    )
    coordinates = {dim: (dim, forecasts[dim].values, forecasts[dim].attrs) for dim in DIMS} | {"bin": bins}
    scores = Dataset(coords=coordinates, attrs={"scored_variable": name, "horizon": horizon_of(forecasts)})
    for rival, guess in guesses.items():
        brier = np.tensordot(_brier(happened, guess.chance), shares, axes=1)
        scores[f"brier_{rival}"] = DataArray(brier, dims=DIMS)
        scores[f"contour_distance_{rival}"] = DataArray(
            _contour_distances(_contours(forecasts, guess.field), contours, brier.shape), dims=DIMS
        )
        scores[f"arrival_error_{rival}"] = DataArray(_arrival_errors(forecasts, guess, shares), dims=DIMS)
    for part, values in _reliability(guesses["belief"].chance, happened, shares).items():
        scores[f"reliability_{part}"] = DataArray(values, dims=(*DIMS, "bin"))
    if "area" in forecasts.dims:
        scores = scores.assign(_of_areas(forecasts))
    for label, variable in scores.data_vars.items():
        score, _, rival = str(label).rpartition("_")
        if rival in RIVALS:
            units, title = TITLES[score]
            variable.attrs |= {"units": units, "long_name": f"{title}, forecast '{rival}'"}
        elif label in TITLES:
            units, title = TITLES[str(label)]
            variable.attrs |= {"units": units, "long_name": title}
    return scores


def guesses_of(forecasts: Dataset, prefix: str) -> dict[str, Guess]:
    """Return the compared forecasts of nodes (``prefix`` empty) or of areas (``area_``)."""
    name, horizon = str(forecasts.attrs["scored_variable"]), horizon_of(forecasts)
    dim = "node" if not prefix else prefix.removesuffix("_")
    chance = _values(forecasts, f"{prefix}exceedance_probability", *DIMS, dim)
    reach = _values(forecasts, f"{prefix}reach_probability", "issue", "threshold", dim)
    arrival = _median_arrival(forecasts, f"{prefix}arrival_time", dim, horizon)
    field = None if prefix else _median_field(forecasts[f"{name}_exceeded"])
    found = {"belief": Guess(chance, reach, arrival, field)}
    if f"{prefix}{name}_free" in forecasts:
        free = _values(forecasts, f"{prefix}{name}_free", "issue", "lead", dim)
        own = _values(forecasts, f"{prefix}arrival_time_free", "issue", "threshold", dim)
        above = (free[:, :, np.newaxis] > forecasts["threshold"].values[:, np.newaxis]).astype(float)
        reached = np.isfinite(own)
        found["free"] = Guess(above, reached.astype(float), np.where(reached, own, horizon), None if prefix else free)
    still = field[:, :1] if field is not None else None
    found["now"] = _standing(chance[:, :1], chance.shape, still, horizon)
    first = _values(forecasts, f"{prefix}exceedance_probability_released", "threshold", dim)
    still = None if prefix else _median_field(forecasts[f"{name}_exceeded_released"])[np.newaxis, np.newaxis]
    found["released"] = _standing(first[np.newaxis, np.newaxis], chance.shape, still, horizon)
    return found


def _standing(chance: Array, shape: tuple[int, ...], field: Array | None, horizon: float) -> Guess:
    """Return the forecast that nothing changes, from its probabilities (issue or 1, 1, threshold, m)."""
    reach = np.broadcast_to(chance[:, 0], (shape[0], *shape[2:]))
    arrival = np.where(reach >= MEDIAN, 0.0, horizon)
    wide = None if field is None else np.broadcast_to(field, (shape[0], shape[1], shape[3]))
    return Guess(np.broadcast_to(chance, shape), reach, arrival, wide)


def horizon_of(forecasts: Dataset) -> float:
    """Return the horizon of the forecasts in seconds."""
    return float(forecasts.attrs["horizon"])


def node_shares(forecasts: Dataset) -> Array:
    """Return the share (n,) of the site that belongs to each node: a third of its triangles; without a mesh equal."""
    size = forecasts.sizes["node"]
    if "mesh2d_face_nodes" not in forecasts:
        return np.full(size, 1.0 / size)
    nodes = np.column_stack([forecasts[axis].values for axis in ("node_x", "node_y")])
    areas = node_areas(nodes, forecasts["mesh2d_face_nodes"].values.astype(int))
    return areas / areas.sum()


def _values(forecasts: Dataset, name: str, *dims: str) -> Array:
    return forecasts[name].transpose(*dims).values.astype(np.float64)


def _median_field(exceeded: DataArray) -> Array:
    return exceeded.sel(probability=MEDIAN).values.astype(np.float64)


def _median_arrival(forecasts: Dataset, name: str, dim: str, horizon: float) -> Array:
    """Return the median of the time of arrival (issue, threshold, m), the horizon where it is not within it."""
    times = _values(forecasts.sel(quantile=MEDIAN), name, "issue", "threshold", dim)
    return np.where(np.isnan(times), horizon, times)


def _brier(happened: Any, chance: Array) -> Array:
    """Return the Brier score: the squared difference of what was promised and what happened, which is 0 or 1."""
    return (chance - happened) ** 2


def _contours(forecasts: Dataset, field: Array | None) -> list[Array]:
    """Return the contours of a field (issue, lead, n) by issue, lead and threshold; none without a mesh."""
    if "mesh2d_face_nodes" not in forecasts or field is None:
        return []
    nodes = np.column_stack([forecasts["node_x"].values, forecasts["node_y"].values])
    triangles = forecasts["mesh2d_face_nodes"].values.astype(np.int32)
    limits = forecasts["threshold"].values.tolist()
    return [contour_of(nodes, triangles, values, limit) for one in field for values in one for limit in limits]


def _contour_distances(one: list[Array], other: list[Array], shape: tuple[int, ...]) -> Array:
    """Return the distances in metres, in a ``shape``, between contours; NaN without a mesh."""
    if not one or not other:
        return np.full(shape, np.nan)
    return np.reshape([contour_distance(*pair) for pair in zip(one, other, strict=True)], shape)


def _arrival_errors(forecasts: Dataset, guess: Guess, shares: Array) -> Array:
    """Return the mean error in s (issue, lead, threshold) of the time of arrival where the truth arrives by then.

    A lead time has the places that the truth reaches after the lead time before, and up to it; NaN if there are none.
    """
    arrived = _values(forecasts, "arrival_time_truth", "issue", "threshold", "node")
    leads = forecasts["lead"].values
    found = np.full((arrived.shape[0], leads.size, arrived.shape[1]), np.nan)
    errors = np.abs(guess.arrival - arrived)
    for row, (before, lead) in enumerate(zip([-np.inf, *leads[:-1]], leads, strict=True)):
        among = (arrived > before) & (arrived <= lead)
        weight = (among * shares).sum(axis=-1)
        total = np.where(among, errors * shares, 0.0).sum(axis=-1)
        found[:, row] = np.divide(total, weight, out=np.full(total.shape, np.nan), where=weight > 0.0)
    return found


def bin_of(chance: Array) -> Any:
    """Return the number of the bin that holds a probability."""
    return np.floor(chance * BINS + 0.5).astype(int)


def _reliability(chance: Array, happened: Any, shares: Array) -> dict[str, Array]:
    """Return for each bin the share of the site, and the sums of promised probabilities and of what happened."""
    weights = np.broadcast_to(shares, chance.shape)
    bins = bin_of(chance)
    inside = [bins == number for number in range(BINS + 1)]

    def sums(values: Array) -> Array:
        return np.stack([np.where(here, values, 0.0).sum(axis=-1) for here in inside], axis=-1)

    return {"share": sums(weights), "promised": sums(weights * chance), "happened": sums(weights * happened)}


def _of_areas(forecasts: Dataset) -> Mapping[str, DataArray]:
    """Return, by issue, threshold and area: promised probabilities, what happened, and scores of the arrival."""
    dims, horizon = ("issue", "threshold", "area"), horizon_of(forecasts)
    arrived = _values(forecasts, "area_arrival_time_truth", *dims)
    found = {"area_happened": np.isfinite(arrived).astype(float)}
    for rival, guess in guesses_of(forecasts, "area_").items():
        found[f"area_promised_{rival}"] = guess.reach
        found[f"area_brier_{rival}"] = _brier(found["area_happened"], guess.reach)
        # The CRPS of the time of arrival, in which all times beyond the horizon are the same.
        if rival != "belief":
            found[f"area_arrival_crps_{rival}"] = np.abs(guess.arrival - np.nan_to_num(arrived, nan=horizon))
    members = np.nan_to_num(_values(forecasts, "area_arrival_time_members", "member", *dims), nan=np.inf)
    off = np.minimum(members, horizon) - np.minimum(np.nan_to_num(arrived, nan=np.inf), horizon)
    weights = np.broadcast_to(forecasts["weight"].values.T[:, :, np.newaxis, np.newaxis], off.shape)
    found["area_arrival_crps_belief"] = crps_of_errors(off, weights)
    made = {name: DataArray(values, dims=dims) for name, values in found.items()}
    return made | {
        "area_name": DataArray(forecasts["area_name"].values, dims="area", attrs=forecasts["area_name"].attrs)
    }
