"""Maps at chosen times: truth, belief, and what the belief has too much or too little."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from dafw.core.errors import ConfigurationError, RunError
from dafw.views.contents import buildings, has_map, label, landmark, scored_variable, stage, time_units, triangulation
from dafw.views.maps import RELEASE, draw_field, height_to_width
from dafw.views.style import (
    BELIEF_COLOUR,
    HALO,
    ColourScale,
    colour_scale,
    draw_buildings,
    map_axes,
    new_figure,
    peak_at_end,
    spread_scale,
)

if TYPE_CHECKING:
    from xarray import Dataset

COLUMN = 2.5
"""Inches of a map."""


def plot_times(run: Dataset, times: Sequence[float]) -> Figure:
    """Draw a row of maps for every time: truth, belief, belief minus truth; without a truth belief and spread.

    All maps of the truth and the belief have one scale, all differences another one about zero. The vehicles' ways are
    drawn up to the time. Raises RunError if the run has no map, ConfigurationError if a time is none of its times.
    """
    name = scored_variable(run)
    rows = rows_at(run, times)
    belief, truth, spread = (stage(run, name, key) for key in ("mean", "truth", "spread"))
    assert belief is not None
    columns: dict[str, np.ndarray] = {"Belief": belief[rows]}
    if truth is not None:
        columns = {"Truth": truth[rows], **columns, "Belief minus truth": belief[rows] - truth[rows]}
    elif spread is not None:
        columns["Spread of the belief"] = spread[rows]
    reference = columns.get("Truth", columns["Belief"])
    common = colour_scale(
        reference, peak_at_end(reference), *(columns[key] for key in columns if key in ("Truth", "Belief"))
    )
    last = next(reversed(columns))
    scales = dict.fromkeys(columns, common)
    difference = difference_scale(columns[last]) if last == "Belief minus truth" else None
    if difference is not None:
        scales[last] = difference
    elif last != "Belief":
        scales[last] = spread_scale(columns[last])

    mesh, outlines = triangulation(run), buildings(run)
    height = COLUMN * height_to_width(mesh)
    figure = new_figure(COLUMN * len(columns) + 0.5, height * len(rows) + 1.0, maps=True)
    grid = figure.subplots(len(rows), len(columns), sharex=True, sharey=True, squeeze=False)
    fields: dict[str, Any] = {}
    for number, row in enumerate(rows):
        for axes, (title, values) in zip(grid[number], columns.items(), strict=True):
            fields[title] = draw_field(axes, mesh, values[number], scales[title])
            draw_buildings(axes, outlines)
            if (place := landmark(run, "release")) is not None:
                axes.plot(*place, **RELEASE | {"markersize": 5}, zorder=4)
            _draw_ways(axes, run, row)
            map_axes(axes, mesh.x, mesh.y)
            axes.set(xticks=[], yticks=[])
            if number == 0:
                axes.set_title(title, fontsize=10)
        grid[number, 0].set_ylabel(f"t = {float(run['time'][row]):g} {time_units(run)}", fontsize=10)
        if "err" in run.variables and truth is not None:
            error = f"ERR {float(run['err'][row]):.3g} %"
            grid[number, -1].text(
                0.98,
                0.03,
                error,
                transform=grid[number, -1].transAxes,
                ha="right",
                fontsize=9,
                path_effects=HALO,
                zorder=6,
            )
    groups = [
        [title for title in columns if scales[title] is common],
        [title for title in columns if scales[title] is not common],
    ]
    for titles in filter(None, groups):
        which = [list(columns).index(title) for title in titles]
        what = label(run, name) if titles[0] != "Spread of the belief" else f"standard deviation of {label(run, name)}"
        figure.colorbar(
            fields[titles[0]],
            ax=list(grid[:, which].flat),
            location="bottom",
            extend=scales[titles[0]].extend,
            label=what,
            ticks=None if scales[titles[0]] is not difference else [difference.norm.vmin, 0.0, difference.norm.vmax],
            pad=0.02,
            aspect=18 * len(which),
            fraction=0.05,
        )
    return figure


def rows_at(run: Dataset, times: Sequence[float]) -> list[int]:
    """Return the rows of some times, in s; raises RunError or ConfigurationError if a map cannot be drawn of one."""
    name = scored_variable(run)
    if not has_map(run):
        raise RunError(f"maps at chosen times need a field on a mesh, which '{name}' of this run is not")
    kept = np.flatnonzero(np.isfinite(run[f"{name}_mean"].values).any(axis=1))
    recorded = run["time"].values[kept]
    rows = []
    for time in times:
        off = np.abs(recorded - time)
        if not len(off) or off.min() > 1e-6 * max(1.0, abs(time)):
            near = f"; the nearest is {recorded[int(off.argmin())]:g}" if len(off) else ""
            raise ConfigurationError(f"plot: the run has no map at t = {time:g} {time_units(run)}{near}")
        rows.append(int(kept[int(off.argmin())]))
    return rows


def difference_scale(differences: np.ndarray) -> ColourScale:
    """Return a scale with zero in its middle: too little is blue, too much is red."""
    largest = float(np.nanmax(np.abs(differences))) or 1.0
    power = 10.0 ** np.floor(np.log10(largest))
    largest = float(f"{power * min(step for step in (1, 2, 3, 5, 10) if step * power >= 0.999 * largest):g}")
    return ColourScale(matplotlib.colormaps["RdBu_r"], Normalize(-largest, largest), "neither")


def _draw_ways(axes: Axes, run: Dataset, row: int) -> None:
    if "vehicle_x" not in run.variables:
        return
    for x, y in zip(run["vehicle_x"].values.T, run["vehicle_y"].values.T, strict=True):
        axes.plot(
            x[: row + 1], y[: row + 1], color=BELIEF_COLOUR, linewidth=0.9, path_effects=HALO, zorder=3, gid="route"
        )
        axes.plot(x[row], y[row], "^", color="black", markeredgecolor="white", markersize=5, zorder=5, gid="vehicle")
