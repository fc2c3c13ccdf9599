"""Maps: the route over the belief (the paper's Fig. 4), and the four-panel picture of the concentration (Fig. 6)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dafw.core.errors import RunError
from dafw.views.contents import (
    buildings,
    has_map,
    is_positive,
    label,
    landmark,
    polyline,
    scored_variable,
    stage,
    time_units,
    triangulation,
)
from dafw.views.style import (
    HALO,
    SECTION_COLOUR,
    ColourScale,
    colour_scale,
    draw_buildings,
    map_axes,
    new_figure,
    outside_legend,
    peak_at_end,
    run_style,
    spread_scale,
)

if TYPE_CHECKING:
    from matplotlib.tri import Triangulation
    from xarray import Dataset

RELEASE: dict[str, Any] = {
    "marker": "o",
    "color": "#FFD92F",
    "markeredgecolor": "black",
    "markersize": 10,
    "linestyle": "none",
}
START: dict[str, Any] = {
    "marker": "s",
    "markerfacecolor": "white",
    "markeredgewidth": 1.8,
    "markersize": 8,
    "linestyle": "none",
}
END: dict[str, Any] = {
    "marker": "*",
    "markeredgecolor": "white",
    "markeredgewidth": 0.8,
    "markersize": 16,
    "linestyle": "none",
}


def plot_route(runs: Mapping[str, Dataset]) -> Figure:
    """Draw the paths of the vehicles of one or several runs, and the places of the readings.

    The background is the first run's analysis mean at its last time. Raises RunError if that is no field on a mesh.
    """
    background_label, run = next(iter(runs.items()))
    name = scored_variable(run)
    if not has_map(run):
        raise RunError(f"a route needs a field on a mesh, which '{name}' of this run is not")
    belief = run[f"{name}_mean"].values[-1]
    mesh = triangulation(run)
    scale = colour_scale(belief, float(np.nanmax(belief)), belief)

    figure = new_figure(8.0, 6.4 * height_to_width(mesh) + 1.4, maps=True)
    axes = figure.subplots()
    field = draw_field(axes, mesh, belief, scale)
    draw_buildings(axes, buildings(run))
    handles: list[Line2D] = []
    for index, (text, one) in enumerate(runs.items()):
        style = run_style(index, len(runs))
        draw_route(axes, one, style)
        entry = text if len(runs) > 1 else "route and readings" if one.sizes.get("vehicle") else "readings"
        line = style if one.sizes.get("vehicle") else style | {"linestyle": "none"}
        handles.append(Line2D([], [], **line, marker="o", markersize=4, label=entry))
    if (position := landmark(run, "release")) is not None:
        handles += axes.plot(*position, **RELEASE, zorder=4.5, label="release")
    if any(one.sizes.get("vehicle") for one in runs.values()):
        handles.append(Line2D([], [], **START, markeredgecolor="black", label="start"))
        handles.append(Line2D([], [], **END, color="black", label="end"))

    map_axes(axes, mesh.x, mesh.y)
    axes.set(xlabel="x (m)", ylabel="y (m)")
    whose = f" of {background_label}" if len(runs) > 1 else ""
    axes.set_title(f"Places of the readings, over the belief{whose} at t = {_last_time(run)}", fontsize=11)
    figure.colorbar(field, ax=axes, label=label(run, name), extend=scale.extend, pad=0.02)
    outside_legend(figure, handles, "lower")
    return figure


def plot_contours(run: Dataset) -> Figure:
    """Draw the truth at the start and at the end, the free run and the belief at the end, on one colour scale.

    Without a truth: the belief at the start and at the end, and its spread at the end, on a scale of its own. Without
    a free run its panel is left out. The polyline gamma of the section is drawn if the run has one. Raises RunError if
    the scored variable is no field on a mesh.
    """
    name = scored_variable(run)
    if not has_map(run):
        raise RunError(f"a contour picture needs a field on a mesh, which '{name}' of this run is not")
    truth, free, belief = stage(run, name, "truth"), stage(run, name, "free"), run[f"{name}_mean"].values
    begin, end = f"t = {float(run['time'][0]):g} {time_units(run)}", f"t = {_last_time(run)}"
    reference = belief if truth is None else truth
    what = "Belief" if truth is None else "Truth"
    panels = {f"{what}, {begin}": reference[0], f"{what}, {end}": reference[-1]}
    if free is not None:
        panels[f"Free run, {end}{_error(run, 'err_free')}"] = free[-1]
    if truth is not None:
        panels[f"Belief, {end}{_error(run, 'err')}"] = belief[-1]
    scale = colour_scale(reference, peak_at_end(reference), *panels.values())
    scales = dict.fromkeys(panels, scale)
    spread = stage(run, name, "spread") if truth is None else None
    if spread is not None:
        title = f"Spread of the belief, {end}"
        panels[title], scales[title] = spread[-1], spread_scale(spread[-1])

    mesh, outlines = triangulation(run), buildings(run)
    rows, columns = (2, 2) if len(panels) == 4 else (1, len(panels))
    figure = new_figure(4.8 * columns, 3.9 * rows * height_to_width(mesh) + 1.5, maps=True)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes, (title, values) in zip(grid.flat, panels.items(), strict=True):
        field = draw_field(axes, mesh, values, scales[title])
        draw_buildings(axes, outlines)
        handles = _draw_section(axes, run)
        if (position := landmark(run, "release")) is not None:
            handles += axes.plot(*position, **RELEASE | {"markersize": 6}, zorder=4, label="release")
        axes.set_title(title, fontsize=10.5)
        map_axes(axes, mesh.x, mesh.y)
        if scales[title] is not scale:
            beside = axes.inset_axes((1.03, 0.0, 0.04, 1.0))
            what = f"the logarithm of {label(run, name, '')}" if is_positive(run, name) else label(run, name)
            figure.colorbar(field, cax=beside, label=f"standard deviation of {what}")
    for axes in grid[-1]:
        axes.set_xlabel("x (m)")
    for axes in grid[:, 0]:
        axes.set_ylabel("y (m)")
    # With two colour bars on the same side one could not see to which panels the outer one belongs.
    bar = figure.colorbar(
        grid.flat[0].collections[0],
        ax=grid,
        location="right" if spread is None else "left",
        extend=scale.extend,
        pad=0.02,
        aspect=16 * rows,
    )
    bar.set_label(label(run, name))
    if handles:
        outside_legend(figure, handles, "lower")
    return figure


def draw_field(axes: Axes, mesh: Triangulation, values: np.ndarray, scale: ColourScale) -> Any:
    """Colour a map by ``values`` (node,); return what a colour bar needs."""
    # Rasterised: a vector format would otherwise hold every triangle.
    return axes.tripcolor(mesh, values, shading="gouraud", rasterized=True, zorder=1, **scale.keywords)


def height_to_width(mesh: Triangulation) -> float:
    """Return the height of a map over its width."""
    return float(np.ptp(mesh.y) / np.ptp(mesh.x))


def draw_route(axes: Axes, run: Dataset, style: dict[str, Any]) -> None:
    """Draw the nodes that one run read, and every vehicle's path with its start and end."""
    colour = style["color"]
    if "observation_x" in run.variables:
        x, y = run["observation_x"].values.ravel(), run["observation_y"].values.ravel()
        seen = np.isfinite(x) & np.isfinite(y)
        axes.plot(x[seen], y[seen], "o", color=colour, markersize=4.5, mec="white", mew=0.6, zorder=3.5, gid="nodes")
    if "vehicle_x" in run.variables:
        for x, y in zip(run["vehicle_x"].values.T, run["vehicle_y"].values.T, strict=True):
            axes.plot(x, y, **style, linewidth=1.3, path_effects=HALO, zorder=3, gid="route")
            axes.plot(x[0], y[0], **START, markeredgecolor=colour, zorder=5, gid="start")
            axes.plot(x[-1], y[-1], **END, color=colour, zorder=5, gid="end")


def _draw_section(axes: Axes, run: Dataset) -> list[Line2D]:
    if "section_x" not in run.variables:
        return []
    x, y = polyline(run, "section").T
    lines = axes.plot(
        x, y, color=SECTION_COLOUR, linewidth=1.6, path_effects=HALO, zorder=3, label="section γ(s)", gid="section"
    )
    dot = axes.plot(x[0], y[0], "o", color=SECTION_COLOUR, mec="white", markersize=6, zorder=3.5, label="s = 0")
    return [*lines, *dot]


def _last_time(run: Dataset) -> str:
    return f"{float(run['time'][-1]):g} {time_units(run)}"


def _error(run: Dataset, score: str) -> str:
    return f" (ERR {float(run[score][-1]):.1f} %)" if score in run.variables else ""
