"""Figures of a study of many runs: ERR over time with bands, success curves, the best and the worst seed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from dafw.core.runs import open_run
from dafw.views.contents import buildings, has_map, label, scored_variable, stage, triangulation
from dafw.views.files import save
from dafw.views.maps import draw_field, draw_route, height_to_width
from dafw.views.style import (
    BELIEF_COLOUR,
    FREE_COLOUR,
    RUN_COLOURS,
    colour_scale,
    draw_buildings,
    map_axes,
    new_figure,
    outside_legend,
    peak_at_end,
    run_style,
    time_axis,
)

if TYPE_CHECKING:
    from xarray import Dataset

EMPTY = 100.0
"""ERR in per cent of a map of zeros: its difference from the truth is the truth."""
BEYOND = 1e9
"""What stands for the ERR of a run that has failed: above every picture."""
HEADROOM = 2.5
"""No picture of ERR goes higher than this many times the free run's median, or the empty map's 100 %."""


def draw_study(study: Dataset, folder: Path) -> list[Path]:
    """Write the figures of a study to ``folder/figures`` and return the files; ``folder`` holds its runs.

    Studies without a truth have no ERR, and so no figures.
    """
    place = folder / "figures"
    if "err" not in study or not np.isfinite(study["err_final"].values).any():
        return []
    files = [save(plot_study_errors(study), place / "err.png"), save(plot_success(study), place / "success.png")]
    for name in study["configuration"].values:
        one = study.sel(configuration=name)
        final = one["err_final"].values
        if np.isfinite(final).sum() < 2:
            continue
        ends = {"best": int(np.nanargmin(final)), "worst": int(np.nanargmax(final))}
        runs = {}
        for which, number in ends.items():
            with open_run(folder / str(one["folder"].values[number])) as run:
                runs[f"{which}: seed {int(one['seed'].values[number])}"] = run.load()
        files.append(save(plot_best_and_worst(runs, str(name)), place / f"best_and_worst,{name}.png"))
    return files


def plot_study_errors(study: Dataset) -> Figure:
    """Draw ERR over time, one panel for each configuration: median and bands over the seeds, and the free run's median.

    ``study`` is a ``study.nc``. All panels have the same scale. A run that has failed counts as above the picture.
    """
    names = [str(name) for name in study["configuration"].values]
    columns = 2 if len(names) == 4 else min(3, len(names))
    rows = -(-len(names) // columns)
    figure = new_figure(max(5.6, 3.7 * columns), 2.7 * rows + 1.0)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    top, has_free = 0.0, False
    for number, (axes, name) in enumerate(zip(grid.flat, names, strict=False)):
        one = study.sel(configuration=name)
        time, bands = times_of(one), quantiles_over_seeds(one, "err", (0.05, 0.25, 0.5, 0.75, 0.95))
        axes.fill_between(time, bands[0], bands[4], color=BELIEF_COLOUR, alpha=0.14, linewidth=0, gid="band 90")
        axes.fill_between(time, bands[1], bands[3], color=BELIEF_COLOUR, alpha=0.28, linewidth=0, gid="band 50")
        axes.plot(time, bands[2], color=BELIEF_COLOUR, linewidth=1.9, gid="median")
        free = quantiles_over_seeds(one, "err_free", (0.5,))[0] if "err_free" in one else np.full(time.size, np.nan)
        if (free < BEYOND).any():
            has_free = True
            axes.plot(time, free, "--", color=FREE_COLOUR, linewidth=1.5, gid="free")
        axes.axhline(EMPTY, color="black", linewidth=1.0, linestyle=":", gid="empty")
        axes.set_title(name, fontsize=10.5)
        shown = number + columns >= len(names)
        time_axis(axes, time, "s" if shown else "")
        axes.tick_params(labelbottom=shown)
        ceiling = HEADROOM * max(EMPTY, _largest(free))
        top = max(top, 1.06 * EMPTY, min(ceiling, 1.05 * max(_largest(bands[3]), _largest(free))))
    grid.flat[0].set_ylim(0.0, top)
    for axes in grid[:, 0]:
        axes.set_ylabel("ERR (%)")
    for axes in grid.flat[len(names) :]:
        axes.set_visible(False)
    handles: list[Any] = [
        Line2D([], [], color=BELIEF_COLOUR, linewidth=1.9, label="median of the seeds"),
        Patch(color=BELIEF_COLOUR, alpha=0.42, linewidth=0, label="half of them"),
        Patch(color=BELIEF_COLOUR, alpha=0.14, linewidth=0, label="nine in ten"),
    ]
    if has_free:
        handles.append(Line2D([], [], color=FREE_COLOUR, linestyle="--", linewidth=1.5, label="free run, median"))
    handles.append(Line2D([], [], color="black", linestyle=":", linewidth=1.0, label="empty map"))
    outside_legend(figure, handles, "upper")
    return figure


def plot_success(study: Dataset) -> Figure:
    """Draw the success of each configuration: over time, and against other limits of ERR than the study's own.

    Left: the share of the seeds whose ERR stays below the limit from then on. Right: the share of the seeds that end
    below an ERR. Runs that failed count as not successful.
    """
    names = [str(name) for name in study["configuration"].values]
    limit = float(study.attrs["success_below_percent"])
    figure = new_figure(9.6, 4.2)
    left, right = figure.subplots(1, 2, sharey=True)
    handles = []
    last, largest = 0.0, 1.1 * max(EMPTY, limit)
    for number, name in enumerate(names):
        one, style = study.sel(configuration=name), run_style(number, len(names))
        ended = np.isin(one["status"].values, ("complete", "failed"))
        if not ended.any():
            continue
        last = max(last, float(np.nanmax(times_of(one))))
        since = np.sort(one["time_to_success"].values[ended])
        final = np.sort(np.where(np.isfinite(one["err_final"].values), one["err_final"].values, np.inf)[ended])
        for axes, values in ((left, since), (right, final)):
            share = 100.0 * np.arange(1, values.size + 1) / values.size
            known = np.isfinite(values)
            x = np.concatenate([[0.0], values[known], [BEYOND]])
            y = np.concatenate([[0.0], share[known], share[known][-1:] if known.any() else [0.0]])
            axes.step(x, y, where="post", **style, linewidth=1.8, gid="success")
        largest = max(largest, min(HEADROOM * EMPTY, 1.05 * _largest(final)))
        handles.append(Line2D([], [], **style, linewidth=1.8, label=name))
    time_axis(left, np.array([0.0, last]), "s")
    left.set_ylabel("share of the seeds (%)")
    left.set_title(f"ERR stays below {limit:g} % from t on", fontsize=10.5)
    time_axis(right, np.array([0.0, largest]), "")
    right.set_xlabel("ERR at the end (%)")
    right.set_title("ends with an ERR below x", fontsize=10.5)
    right.axvline(limit, color=FREE_COLOUR, linewidth=1.0, linestyle="--", gid="limit")
    right.axvline(EMPTY, color="black", linewidth=1.0, linestyle=":", gid="empty")
    left.set_ylim(-2.0, 102.0)
    handles.append(Line2D([], [], color=FREE_COLOUR, linestyle="--", linewidth=1.0, label=f"success: {limit:g} %"))
    handles.append(Line2D([], [], color="black", linestyle=":", linewidth=1.0, label="empty map"))
    outside_legend(figure, handles, "lower")
    return figure


def plot_best_and_worst(runs: dict[str, Dataset], name: str) -> Figure:
    """Draw two runs of a configuration: their last maps of truth and belief with the route; without maps, their ERR."""
    if all(has_map(run) for run in runs.values()):
        return _maps(runs, name)
    figure = new_figure(9.0, 3.6)
    row = figure.subplots(1, len(runs), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (title, run) in zip(row, runs.items(), strict=True):
        if "err_free" in run:
            axes.plot(run["time"].values, run["err_free"].values, "--", color=FREE_COLOUR, label="free run")
        axes.plot(run["time"].values, run["err"].values, color=BELIEF_COLOUR, linewidth=1.9, label="belief")
        axes.set_title(_with_error(title, run), fontsize=10.5)
        time_axis(axes, run["time"].values, "s")
    row[0].set_ylim(bottom=0.0)
    row[0].set_ylabel("ERR (%)")
    figure.suptitle(name, fontsize=11.5)
    outside_legend(figure, row[0].get_lines(), "lower")
    return figure


def _maps(runs: dict[str, Dataset], name: str) -> Figure:
    """Draw the truth and the belief of each run; the truth once if both have the same."""
    panels: list[tuple[str, Dataset, np.ndarray, int | None]] = []
    for number, (title, run) in enumerate(runs.items()):
        scored = scored_variable(run)
        truth = stage(run, scored, "truth")
        if truth is not None and not any(_same(truth[-1], values) for _, _, values, _ in panels):
            panels.append(("truth" if number == 0 else f"truth of seed {run.attrs['seed']}", run, truth[-1], None))
        panels.append((_with_error(title, run), run, run[f"{scored}_mean"].values[-1], number))
    first = panels[0][1]
    over_time = stage(first, scored_variable(first), "truth")
    reference = first[f"{scored_variable(first)}_mean"].values if over_time is None else over_time
    scale = colour_scale(reference, peak_at_end(reference), *(values for _, _, values, _ in panels))
    mesh = triangulation(first)
    columns = 2 if len(panels) == 4 else len(panels)
    rows = len(panels) // columns
    figure = new_figure(4.3 * columns, 4.0 * rows * height_to_width(mesh) + 0.9, maps=True)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes, (title, run, values, route) in zip(grid.flat, panels, strict=True):
        mesh = triangulation(run)
        field = draw_field(axes, mesh, values, scale)
        draw_buildings(axes, buildings(run))
        if route is not None:
            draw_route(axes, run, {"color": RUN_COLOURS[2], "linestyle": "-"})
        axes.set_title(title, fontsize=10.5)
        map_axes(axes, mesh.x, mesh.y)
    for axes in grid[-1]:
        axes.set_xlabel("x (m)")
    for axes in grid[:, 0]:
        axes.set_ylabel("y (m)")
    figure.colorbar(field, ax=grid, label=label(first, scored_variable(first)), extend=scale.extend, pad=0.02)
    figure.suptitle(f"{name}, at t = {float(first['time'][-1]):g} s", fontsize=11.5)
    return figure


def _with_error(title: str, run: Dataset) -> str:
    return f"{title}, ERR {float(run['err'][-1]):.1f} %"


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    return a.shape == b.shape and np.array_equal(a, b, equal_nan=True)


def times_of(one: Dataset) -> np.ndarray:
    """Return the times of a configuration's rows; those of its longest run if runs have times of their own."""
    if "time" in one.coords:
        return one["time"].values
    times = one["row_time"].values
    return np.asarray(times[np.isfinite(times).sum(axis=-1).argmax()])


def quantiles_over_seeds(one: Dataset, name: str, probabilities: tuple[float, ...]) -> np.ndarray:
    """Return quantiles (k, time) over the seeds that ended; a run that has failed counts as larger than all others."""
    ended = np.isin(one["status"].values, ("complete", "failed"))
    values = one[name].transpose("seed", "time").values[ended]
    if not values.size:
        return np.full((len(probabilities), one.sizes["time"]), np.nan)
    quantiles = np.quantile(np.where(np.isfinite(values), values, BEYOND), probabilities, axis=0)
    # Times that no run of this configuration has, because another one is longer.
    return np.where(np.isfinite(values).any(axis=0), quantiles, np.nan)


def _largest(values: np.ndarray) -> float:
    """Return the largest number that is not of failed runs; 0 if there is none."""
    known = values[np.isfinite(values) & (values < BEYOND / 10.0)]
    return float(known.max()) if known.size else 0.0
