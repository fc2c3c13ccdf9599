"""The results of many runs as one tidy Dataset: ``study.nc``, with the dimensions configuration, seed and time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from xarray import Dataset, Variable

from dafw.core.errors import DafwError
from dafw.core.files import write_dataset
from dafw.core.grid_of_runs import join
from dafw.core.runs import open_run, summary_of
from dafw.core.space import Kind, StateSpace
from dafw.core.space import Variable as StateVariable
from dafw.studies.floors import known_floors
from dafw.studies.many_runs import run_folder
from dafw.studies.study_files import ManyRuns

OVER_TIME = ("err", "err_free", "err_smoothed", "spread", "innovation_rms")
"""Variables of a run over time that ``study.nc`` keeps."""
NORMAL_90 = 1.6448536269514722
"""Half the width of the interval that holds 90 % of a normal distribution, in standard deviations."""


def gather(study: ManyRuns, folder: Path) -> Dataset:
    """Return the results of a study's runs; what a run does not have is NaN.

    Numbers over time are also there for runs that failed, up to then. Numbers of the end are those of complete runs.
    """
    places = [
        [run_folder(folder, configuration, seed) for seed in study.seeds] for configuration in study.configurations
    ]
    overrides = {one.name: " ".join(one.overrides) for one in study.configurations}
    joined = joined_results(folder, overrides, study.seeds, places, study.success)
    for axis in study.configurations[0].place:
        found = [one.place[axis] for one in study.configurations]
        title = f"value of '{axis}' in the configuration"
        joined = joined.assign_coords({axis: ("configuration", _numbers(found), {"long_name": title})})
    joined.attrs = {"title": study.title, "study": study.name, "success_below_percent": study.success}
    if study.floor is not None:
        floors = known_floors(study, folder)
        values = [floors.get(one.name, np.nan) for one in study.configurations]
        long_name = "smallest ERR at the end that was found with constant parameters"
        joined["floor"] = Variable("configuration", values, {"units": "percent", "long_name": long_name})
    return joined


def joined_results(
    folder: Path,
    overrides: Mapping[str, str],
    seeds: Sequence[int],
    places: Sequence[Sequence[Path | None]],
    success: float,
) -> Dataset:
    """Return the results of runs in a folder, with the dimensions configuration, seed and time.

    ``overrides`` are those of each configuration, by its name; ``places`` has for each configuration and seed the
    folder of the run, or None if there is none; ``success`` is the ERR (per cent) below which a run has succeeded.
    """
    runs: dict[tuple[int, ...], Dataset] = {}
    told = {name: np.full((len(overrides), len(seeds)), "", dtype=object) for name in ("status", "error", "folder")}
    for row, line in enumerate(places):
        for column, place in enumerate(line):
            summary = {} if place is None else summary_of(place)
            told["status"][row, column] = str(summary.get("status", "missing"))
            told["error"][row, column] = str(summary.get("error", ""))
            told["folder"][row, column] = "" if place is None else str(place.relative_to(folder))
            if place is not None and told["status"][row, column] in ("complete", "failed"):
                found = _results(place, summary)
                runs |= {(row, column): found} if found is not None else {}
    names = {"configuration": np.array([*overrides]), "seed": np.array(seeds)}
    joined = join(runs, names, {name: values.astype(np.str_) for name, values in told.items()}).load()
    # Joined runs have a number that is the same in all of them only once; a tidy file has it for each run.
    once = {name: values.broadcast_like(joined["status"]) for name, values in joined.items() if not values.dims}
    joined = joined.assign(once)
    joined = joined.assign_coords({"overrides": ("configuration", np.array([*overrides.values()]))})
    joined = joined.assign(time_to_success=_time_to_success(joined, success))
    for name, long_name in (
        ("configuration", "name of the configuration"),
        ("overrides", "what the configuration changes in the study"),
        ("seed", "seed of every random number of a run"),
        ("status", "how a run ended: complete, failed, interrupted or missing"),
        ("error", "why a run failed"),
        ("folder", "folder of a run in that of the study"),
    ):
        joined[name].attrs["long_name"] = long_name
    joined["seed"].attrs["units"] = "1"
    return joined


def write_study(results: Dataset, file: Path) -> None:
    """Write ``study.nc``; a reader sees the old file or the new one, never a part."""
    write_dataset(file, results)


def _time_to_success(joined: Dataset, success: float) -> Variable:
    """Return for each run the time from which ERR stays below ``success`` per cent; infinity if it does not.

    NaN where there is no ERR or no finished run. A run that failed has not stayed below.
    """
    dims = ("configuration", "seed")
    status = joined["status"].values
    found = np.where(status == "failed", np.inf, np.full(status.shape, np.nan))
    if "err" in joined:
        err = joined["err"].transpose(*dims, "time").values
        time = (
            joined["row_time" if "row_time" in joined else "time"]
            .broadcast_like(joined["err"])
            .transpose(*dims, "time")
        )
        for place in map(tuple, np.argwhere(status == "complete")):
            known = np.flatnonzero(np.isfinite(err[place]))
            if known.size:
                above = np.flatnonzero(~(err[place][: known[-1] + 1] < success))
                first = above[-1] + 1 if above.size else 0
                found[place] = time.values[place][first] if first <= known[-1] else np.inf
    long_name = f"time from which ERR stays below {success:g} %, infinite if it does not"
    return Variable(dims, found, {"units": "s", "long_name": long_name})


def _numbers(places: list[str]) -> Any:
    """Return the places on an axis as numbers if all of them are numbers."""
    for kind in (np.int64, np.float64):
        try:
            return np.array(places, dtype=kind)
        except ValueError:
            continue
    return np.array(places)


def _results(folder: Path, summary: dict[str, Any]) -> Dataset | None:
    """Return what is kept of one run; None if its file cannot be read."""
    try:
        with open_run(folder) as run:
            kept = run[[name for name in OVER_TIME if name in run.variables]].load()
            if summary["status"] == "complete":
                kept = kept.assign(_at_the_end(run, summary))
    except DafwError:
        return None
    kept.attrs = {}
    return kept.drop_vars([name for name in kept.coords if name != "time"]).chunk()


def _at_the_end(run: Dataset, summary: dict[str, Any]) -> dict[str, Variable]:
    """Return the numbers of a run's end: scores, parameters with their intervals, the amount of gas, the times."""
    found: dict[str, Variable] = {}

    def add(name: str, value: float, units: str, long_name: str) -> None:
        found[name] = Variable((), float(value), {"units": units, "long_name": long_name})

    for name in ("err", "err_free"):
        if name in run.variables:
            add(f"{name}_final", run[name].values[-1], "percent", f"{name} after the last cycle")
    for name in summary.get("parameters_final", {}):
        _add_parameter(add, run, name)
    if (ratio := amount_ratio(run)) is not None:
        add("amount_ratio", ratio, "1", "integral of the belief over that of the truth, after the last cycle")
    phases = {name: seconds for name, seconds in summary["phase_seconds"].items() if name != "set-up"}
    add("seconds", summary["wall_seconds"], "s", "wall time of the run")
    add("cycle_seconds", sum(phases.values()), "s", "wall time of its cycles")
    add("simulated_seconds", run["time"].values[-1] - run["time"].values[0], "s", "length of the run")
    if summary.get("model_seconds") is not None:
        add("model_seconds", summary["model_seconds"], "s", "model time for which members were stepped")
    return found


def _add_parameter(add: Any, run: Dataset, name: str) -> None:
    """Add the last belief about a state variable of size 1, and its 90 % interval.

    The interval is the mean plus and minus 1.645 spreads: of the logarithm for a positive variable, around the circle
    for an angle. (Quantiles of ten members would be their least and their largest at most.) ``inside`` is 1 if it
    holds the truth.
    """
    attributes = run[f"{name}_mean"].attrs
    units, label = str(attributes.get("units", "1")), name.replace("_", " ")
    note = str(attributes.get("comment", ""))
    kind = next((kind for kind in Kind if note.startswith(kind.value)), Kind.FIELD)
    units_of_spread = "1" if kind is Kind.POSITIVE else units
    mean, spread = (float(run[f"{name}_{stage}"].values[-1]) for stage in ("mean", "spread"))
    add(f"final_{name}", mean, units, f"mean of {label} after the last cycle")
    add(f"final_{name}_spread", spread, units_of_spread, f"spread of {label} after the last cycle")
    if f"{name}_truth" not in run.variables:
        return
    truth = float(run[f"{name}_truth"].values[-1])
    space = StateSpace([StateVariable(name, 1, kind)])
    off = float(space.difference(np.array([truth]), np.array([mean]))[0])
    add(f"final_{name}_truth", truth, units, f"truth of {label} after the last cycle")
    add(f"final_{name}_off", -off, units_of_spread, f"mean less truth of {label}")
    known = np.isfinite(off) and np.isfinite(spread)
    inside = float(abs(off) <= NORMAL_90 * spread) if known else np.nan
    add(f"final_{name}_inside", inside, "1", f"whether the 90 % interval of {label} holds the truth")


def amount_ratio(run: Dataset) -> float | None:
    """Return the integral over the mesh of the last belief over that of the truth; None without a mesh or a truth."""
    name = str(run.attrs["scored_variable"])
    wanted = (f"{name}_truth", f"{name}_mean", "mesh2d_face_nodes", "node_x", "node_y")
    if any(variable not in run.variables for variable in wanted):
        return None
    corners = run["mesh2d_face_nodes"].values.astype(int)
    x, y = (run[axis].values[corners] for axis in ("node_x", "node_y"))
    areas = 0.5 * np.abs((x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0]))
    # The field is linear on a triangle: its mean there is that of the corners.
    belief, truth = (
        float(areas @ run[f"{name}_{stage}"].values[-1].astype(np.float64)[corners].mean(axis=1))
        for stage in ("mean", "truth")
    )
    return belief / truth if truth > 0.0 else float("nan")
