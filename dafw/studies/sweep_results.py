"""A multirun as the results of a study: a configuration for each combination of its parameters, other than the seed."""

from __future__ import annotations

import shlex
from pathlib import Path

from xarray import Dataset

from dafw.core.errors import RunError
from dafw.core.runs import summary_of
from dafw.core.sweeps import sweep_folder, sweep_runs
from dafw.studies.outcomes import joined_results

SUCCESS = 50.0
"""ERR at the end, in per cent, below which a run of a multirun counts as a success; a study file has its own."""


def results_of_sweep(path: Path) -> Dataset:
    """Return the results of a multirun as those of a study; raises RunError if it is none, or no run has begun.

    Combinations of which no run has begun are left out. Without a swept seed there is one column of runs, whose seed is
    that of the first of them.
    """
    folder = sweep_folder(path)
    runs = [(words, place) for words, place in sweep_runs(folder) if place is not None]
    if not runs:
        raise RunError(f"{folder}: no run of this multirun has begun")
    told = summary_of(runs[0][1])
    seeds = sorted({_seed(words, told.get("seed", 0)) for words, _ in runs})
    overrides: dict[str, str] = {}
    places: dict[str, dict[int, Path]] = {}
    for words, place in runs:
        parameters = [f"{name}={value}" for name, value in words.items() if name != "seed"]
        name = ",".join(parameters) or str(told.get("name", folder.name))
        overrides[name] = shlex.join(parameters)
        places.setdefault(name, {})[_seed(words, seeds[0])] = place
    grid = [[places[name].get(seed) for seed in seeds] for name in overrides]
    results = joined_results(folder, overrides, seeds, grid, SUCCESS)
    study = str(told.get("name", folder.name))
    results.attrs = {"title": f"Multirun of {study}", "study": study, "success_below_percent": SUCCESS}
    return results


def _seed(words: dict[str, str], otherwise: int) -> int:
    return int(words.get("seed") or otherwise)
