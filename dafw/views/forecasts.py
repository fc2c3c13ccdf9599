"""Pictures of forecasts: reliability diagrams of many runs, and maps of one forecast."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from dafw.core.forecasts.forecast_file import open_forecasts
from dafw.views.contents import buildings, triangulation
from dafw.views.files import save
from dafw.views.maps import draw_field, height_to_width
from dafw.views.style import (
    BELIEF_COLOUR,
    FREE_COLOUR,
    RUN_COLOURS,
    SPREAD,
    TRUTH_COLOUR,
    ColourScale,
    draw_buildings,
    map_axes,
    new_figure,
    outside_legend,
)

if TYPE_CHECKING:
    from xarray import Dataset


MOST_SIZE, LEAST_SIZE = 160.0, 6.0
"""Areas, in square points, of the points of a reliability diagram: of the whole site, and the least."""


def draw_forecasts(forecasts: Mapping[str, Mapping[str, Any]], folder: Path) -> list[Path]:
    """Draw the reliability diagrams of a study's configurations (``study_forecasts``); return the files."""
    return [
        save(plot_reliability(told, name), folder / f"forecast_reliability,{name}.png")
        for name, told in forecasts.items()
    ]


def draw_forecast(folder: Path) -> list[Path]:
    """Draw maps of the last forecast of a run to its ``figures``; return the files. Without a mesh there are none."""
    with open_forecasts(folder) as forecasts:
        if "mesh2d_face_nodes" not in forecasts or not forecasts.sizes["issue"]:
            return []
        return [save(plot_forecast(forecasts), folder / "figures" / "forecast.png")]


def plot_reliability(told: Mapping[str, Any], name: str) -> Figure:
    """Draw promised probability against what happened: at the nodes by lead time, and of the areas.

    One row for each threshold. The area of a point goes with the root of the share of the site that had such a promise.
    Bars are 95 % intervals as if all forecasts of areas were independent; their counts stand above.
    """
    limits = sorted({row["threshold"] for row in told["reliability"]})
    areas = {row["threshold"]: row for row in told.get("areas", [])}
    columns = 2 if areas else 1
    figure = new_figure(4.5 * columns, 4.1 * len(limits) + 0.8)
    grid = figure.subplots(len(limits), columns, sharex=True, sharey=True, squeeze=False)
    handles: list[Any] = []
    for row, limit in enumerate(limits):
        leads = [one for one in told["reliability"] if one["threshold"] == limit]
        axes = grid[row, 0]
        for number, one in enumerate(leads):
            promised, happened = _points(one)
            colour = RUN_COLOURS[number % len(RUN_COLOURS)]
            axes.plot(promised, happened, "-", color=colour, linewidth=1.2, gid="reliability")
            sizes = MOST_SIZE * np.sqrt([share for share in one["share"] if share > 0.0])
            axes.scatter(promised, happened, np.maximum(sizes, LEAST_SIZE), color=colour, linewidths=0, zorder=3)
            if row == 0:
                handles.append(Line2D([], [], color=colour, marker="o", label=f"lead time {one['lead']:g} s"))
        axes.set_title(f"exceeds {limit:g}, at a place", fontsize=10.5)
        if columns == 2:
            _draw_areas(grid[row, 1], areas[limit])
            grid[row, 1].set_title(f"exceeds {limit:g} within {told['horizon']:g} s, in an area", fontsize=10.5)
    for axes in grid.flat:
        axes.plot([0, 1], [0, 1], color=TRUTH_COLOUR, linewidth=1.0, linestyle=":", zorder=1)
        axes.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03), aspect="equal")
        axes.xaxis.set_major_formatter(PercentFormatter(1.0))
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.grid(color="0.9", linewidth=0.8)
        axes.set_axisbelow(True)
    for axes in grid[-1]:
        axes.set_xlabel("promised probability")
    for axes in grid[:, 0]:
        axes.set_ylabel("happened")
    handles.append(Line2D([], [], color=TRUTH_COLOUR, linestyle=":", label="as promised"))
    runs = f"{told['n_runs']} runs" if told["n_runs"] != 1 else "1 run"
    figure.suptitle(f"{name}: {runs}, {len(told['issues'])} forecasts each", fontsize=11.5)
    outside_legend(figure, handles, "lower")
    return figure


def _points(one: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return the bins that have any forecasts."""
    promised, happened = (np.array(one[part], dtype=float) for part in ("promised", "happened"))
    known = np.isfinite(promised)
    return promised[known], happened[known]


def _draw_areas(axes: Any, row: Mapping[str, Any]) -> None:
    """Draw what was promised of areas against what happened, with intervals and counts."""
    promised, happened = _points(row)
    known = [number for number, count in enumerate(row["n"]) if count]
    ends = np.array([row["happened_interval"][number] for number in known], dtype=float).reshape(-1, 2)
    bars = np.clip(np.abs(ends.T - happened), 0.0, None)
    axes.errorbar(promised, happened, yerr=bars, fmt="o", color=BELIEF_COLOUR, capsize=2.5, gid="areas")
    counts = axes.secondary_xaxis("top")
    counts.set_xticks(promised, labels=[str(row["n"][number]) for number in known], fontsize=8, color=FREE_COLOUR)
    counts.tick_params(length=0)


def plot_forecast(forecasts: Dataset, issue: int = -1, threshold: int = 0) -> Figure:
    """Draw maps of the probability that a threshold is exceeded, one for each lead time of a forecast.

    ``forecasts`` is a ``forecast.nc``; ``issue`` and ``threshold`` count in its order. A line shows the truth's contour
    where there is one.
    """
    name, mesh = str(forecasts.attrs["scored_variable"]), triangulation(forecasts)
    one = forecasts.isel(issue=issue, threshold=threshold)
    leads, limit = one["lead"].values, float(one["threshold"])
    columns = 2 if len(leads) in (2, 4) else min(3, len(leads))
    rows = -(-len(leads) // columns)
    figure = new_figure(4.4 * columns, 4.1 * rows * height_to_width(mesh) + 1.1, maps=True)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    scale = ColourScale(SPREAD, _unit(), "neither")
    with_truth = f"{name}_truth" in one
    for number, axes in enumerate(grid.flat[: len(leads)]):
        field = draw_field(axes, mesh, one["exceedance_probability"].values[number], scale)
        if with_truth and (truth := one[f"{name}_truth"].values[number]).max() > limit > truth.min():
            axes.tricontour(mesh, truth, levels=[limit], colors=TRUTH_COLOUR, linewidths=1.2)
        draw_buildings(axes, buildings(forecasts))
        axes.set_title(f"{leads[number]:g} s ahead, t = {float(one['valid_time'][number]):g} s", fontsize=10.5)
        map_axes(axes, mesh.x, mesh.y)
    for axes in grid.flat[len(leads) :]:
        axes.set_visible(False)
    for axes in grid[-1]:
        axes.set_xlabel("x (m)")
    for axes in grid[:, 0]:
        axes.set_ylabel("y (m)")
    title = f"probability that the {name.replace('_', ' ')} exceeds {limit:g}"
    figure.colorbar(field, ax=grid, label=title, pad=0.02)
    figure.suptitle(f"forecast made at t = {float(one['issue']):g} s", fontsize=11.5)
    if with_truth:
        outside_legend(figure, [Line2D([], [], color=TRUTH_COLOUR, label=f"truth: {limit:g}")], "lower")
    return figure


def _unit() -> Any:
    from matplotlib.colors import Normalize

    return Normalize(0.0, 1.0)
