"""From run folders to picture files, for the end of ``dafw run`` and for ``dafw plot``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from dafw.core.errors import RunError
from dafw.core.files import atomic_file
from dafw.core.progress import long_task
from dafw.core.runs import open_run
from dafw.core.sweeps import RECORD, is_sweep, run_folders, sweep_folder
from dafw.views.contents import (
    has_every_field,
    has_innovations,
    has_map,
    has_section,
    has_truth,
    scalar_variables,
    scored_variable,
)
from dafw.views.expected import has_expected, plot_expected
from dafw.views.innovations import plot_innovations
from dafw.views.maps import plot_contours, plot_route
from dafw.views.places import has_places, plot_places
from dafw.views.printing import SCREEN, Paper, fit
from dafw.views.section import plot_section
from dafw.views.series import plot_errors, plot_parameters, plot_state
from dafw.views.times import plot_times

if TYPE_CHECKING:
    from xarray import Dataset

LONGEST_OVERRIDE = 40


def draw_all(run: Dataset, folder: Path, paper: Paper = SCREEN) -> list[Path]:
    """Write every picture for which this run has data, and return the files.

    A truth gives err.png, readings give innovations.png. A field on a mesh gives route.png, contours.png and (with a
    polyline) section.png; a state without coordinates gives state.png; scalars of the state give parameters.png; a
    source of unknown place gives places.png, sensors with unknown backgrounds expected.png. Raises RunError if ``run``
    is not a run of dafw.
    """
    scored = run[f"{scored_variable(run)}_mean"]
    one = {"belief": run}
    pictures: dict[str, Callable[[], Figure]] = {}
    if has_truth(run):
        pictures["err"] = lambda: plot_errors(one)
    if has_innovations(run):
        pictures["innovations"] = lambda: plot_innovations(one)
    if has_map(run):
        pictures["route"] = lambda: plot_route(one)
        pictures["contours"] = lambda: plot_contours(run)
    elif scored.ndim == 2 and run.sizes["time"] > 1 and has_every_field(run):
        pictures["state"] = lambda: plot_state(run)
    if has_places(run):
        pictures["places"] = lambda: plot_places(run)
    if has_expected(run):
        pictures["expected"] = lambda: plot_expected(run)
    if has_section(run):
        pictures["section"] = lambda: plot_section(run)
    if scalar_variables(run):
        pictures["parameters"] = lambda: plot_parameters(run)
    files = []
    with long_task("drawing pictures", len(pictures), "picture") as bar:
        for name, draw in pictures.items():
            files.append(save(draw(), Path(folder) / f"{name}.{paper.format}", paper))
            bar.update()
    return files


def compare(runs: Mapping[str, Dataset], folder: Path, paper: Paper = SCREEN) -> list[Path]:
    """Write err.png and innovations.png of several runs, each in its colour, and route.png; return the files.

    A run without data for a picture is left out of it, with a message on standard error. route.png is drawn only if
    all runs have a map. Raises RunError if nothing can be compared.
    """
    files = []
    for name, draw, has_content, lacking in (
        ("err", plot_errors, has_truth, "no truth"),
        ("innovations", plot_innovations, has_innovations, "no readings"),
        ("route", plot_route, has_map, "no map"),
    ):
        without = [text for text, run in runs.items() if not has_content(run)]
        if not without or (name != "route" and len(without) < len(runs)):
            files.append(save(draw(runs), Path(folder) / f"{name}.{paper.format}", paper))
        if 0 < len(without) < len(runs):
            what = "no route.png" if name == "route" else f"not in {name}.png"
            print(f"dafw: {', '.join(without)}: {lacking}, so {what}", file=sys.stderr)
    if not files:
        raise RunError("the runs have nothing that can be compared: no truth, no readings, no map")
    return files


def draw_runs(
    paths: Sequence[Path], out: Path | None, paper: Paper = SCREEN, times: Sequence[float] = ()
) -> list[Path]:
    """Draw one run, or compare several, and return the files written; with ``times`` only its maps at these times.

    ``paths`` are run folders or their ``run.nc``, or multiruns, which stand for all their runs that have a ``run.nc``.
    Other files that a shell's ``sweep/*`` includes are ignored. The pictures of one run go to ``out`` or to
    ``figures`` in its own folder; a comparison goes to ``out`` or to ``comparison`` in the current folder. Raises
    RunError if a path holds no run that can be read.
    """
    files = [file for path in map(Path, paths) for file in _files_of(path, alone=len(paths) == 1)]
    if not files:
        raise RunError("expected at least one run folder or run.nc to draw, got none")
    runs = [load_run(file) for file in files]
    folder = out or (files[0].parent / "figures" if len(runs) == 1 else Path("comparison"))
    if times:
        if len(runs) > 1:
            raise RunError(f"plot: --times draws the maps of one run, got {len(runs)} runs")
        return [save(plot_times(runs[0], times), folder / f"maps.{paper.format}", paper)]
    if len(runs) == 1:
        return draw_all(runs[0], folder, paper)
    return compare(dict(zip(_labels(files, runs), runs, strict=True)), folder, paper)


def _files_of(path: Path, *, alone: bool) -> list[Path]:
    """Return the file of a run, or those of all runs of a multirun; raises RunError if a multirun has none."""
    if not alone and (path.name == RECORD or _left_nothing(path)):
        return []
    if path.name != RECORD and (not path.is_dir() or (path / "run.nc").exists() or not is_sweep(path)):
        return [path / "run.nc" if path.is_dir() else path]
    files = [run / "run.nc" for run in run_folders(sweep_folder(path)) if (run / "run.nc").exists()]
    if not files:
        raise RunError(f"{path}: none of its runs has left anything to draw")
    return files


def _left_nothing(path: Path) -> bool:
    """Return whether a folder belongs to a job that ended before it recorded anything."""
    return (path / ".hydra").is_dir() and not (path / "run.nc").exists()


def load_run(file: Path) -> Dataset:
    """Read what the pictures need into memory, so that a damaged file is found before anything is drawn."""
    try:
        with open_run(file, indexed=False) as opened:
            # Whole ensembles of fields are large, and no picture shows them.
            large = [name for name, array in opened.variables.items() if {"member", "node"} <= set(array.dims)]
            run = opened.drop_vars(large).load()
    except (OSError, ValueError, RuntimeError, LookupError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RunError(f"cannot read {file} as a run: {reason}") from error
    try:
        scored_variable(run)
    except RunError as error:
        raise RunError(f"{file}: {error}") from None
    if run.sizes["time"] == 0:
        raise RunError(f"{file} holds no time yet: nothing to draw")
    return run


def _labels(files: Sequence[Path], runs: Sequence[Dataset]) -> list[str]:
    """Name runs by the first of these that differs between all runs: overrides, study, study and seed, path."""
    names = [str(run.attrs.get("name", "run")) for run in runs]
    seeds = [f"{name}, seed {run.attrs.get('seed', '?')}" for name, run in zip(names, runs, strict=True)]
    paths = [str(file.parent if file.name == "run.nc" else file) for file in files]
    for candidates in (_own_overrides(files), names, seeds, paths):
        if len(set(candidates)) == len(candidates) and all(candidates):
            return candidates
    raise RunError(f"expected different runs to compare, got the same one twice among {', '.join(paths)}")


def _own_overrides(files: Sequence[Path]) -> list[str]:
    """Return for each run the overrides that are not common to all runs, such as ``policy.theta=0.2``."""
    import yaml

    told = []
    for file in files:
        record = file.parent / ".hydra" / "overrides.yaml"
        try:
            listed = yaml.safe_load(record.read_text(encoding="utf-8")) if record.is_file() else []
        except (OSError, UnicodeError, yaml.YAMLError):
            listed = []  # without a label
        told.append([str(item) for item in listed] if isinstance(listed, list) else [])
    common = set.intersection(*map(set, told))
    return [", ".join(_short(item) for item in one if item not in common) for one in told]


def _short(override: str) -> str:
    """Return an override shortened to fit into a legend: a list of readings, for example, would fill a page."""
    return override if len(override) <= LONGEST_OVERRIDE else f"{override[: LONGEST_OVERRIDE - 3]}..."


def save(figure: Figure, file: Path, paper: Paper = SCREEN) -> Path:
    """Write the picture; if this is interrupted, the former file stays, if there was one."""
    file.parent.mkdir(parents=True, exist_ok=True)
    if paper.width is not None:
        fit(figure, paper.width)
    # The lines around axes need no room of their own. To ask them for it takes a tenth of the time.
    for axes in figure.axes:
        for spine in axes.spines.values():
            spine.set_in_layout(False)
    with atomic_file(file) as stream:
        paper.write(figure, stream)
    return file
