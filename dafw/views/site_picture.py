"""The picture of a study on a site before it is run: buildings, what was done to them, mesh, release, drones, wind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Rectangle

from dafw.views.maps import RELEASE, START
from dafw.views.site_places import Point
from dafw.views.site_preview import Preview
from dafw.views.style import BELIEF_COLOUR, HALO, TRUTH_COLOUR, draw_buildings, new_figure, outside_legend

ADDED, REMOVED, CROSSING = "#E69F00", "#0072B2", "#D55E00"
MESH = "#B4BAC4"
LIMITS: dict[str, Any] = {"fill": False, "linewidth": 1.2, "edgecolor": "black"}
RIM: dict[str, Any] = {"fill": False, "linewidth": 0.8, "edgecolor": "0.35", "linestyle": (0, (4, 3))}
REFUSED: dict[str, Any] = {
    "marker": "X",
    "color": "#D55E00",
    "markeredgecolor": "white",
    "markersize": 13,
    "linestyle": "none",
}


def plot_site(preview: Preview) -> Figure:
    """Draw a study on a site; what cannot be where it is has a red cross."""
    x_min, y_min, x_max, y_max = preview.site.bounds
    nodes, triangles = preview.mesh
    width = 9.0
    figure = new_figure(width, 0.9 * width * (y_max - y_min) / (x_max - x_min) + 1.6, maps=True)
    axes = figure.subplots()
    axes.triplot(*nodes.T, triangles, color=MESH, linewidth=0.35, zorder=1)
    draw_buildings(axes, [np.asarray(building.exterior.coords) for building in preview.site.buildings])
    handles: list[Any] = [Line2D([], [], color=MESH, label=f"mesh, {len(nodes):,} nodes")]
    handles += _draw_changes(axes, preview)
    axes.add_patch(Rectangle((x_min, y_min), x_max - x_min, y_max - y_min, **LIMITS, zorder=3))
    rim = preview.model.site.rim
    axes.add_patch(
        Rectangle((x_min + rim, y_min + rim), x_max - x_min - 2 * rim, y_max - y_min - 2 * rim, **RIM, zorder=1.5)
    )
    handles.append(Line2D([], [], color=RIM["edgecolor"], linestyle=RIM["linestyle"], label="rim, kept free"))
    handles += _draw_places(axes, preview)
    handles += _draw_winds(axes, preview)
    axes.set_aspect("equal")
    room = 0.02 * max(x_max - x_min, y_max - y_min)
    axes.set(xlim=(x_min - room, x_max + room), ylim=(y_min - room, y_max + room), xlabel="x (m)", ylabel="y (m)")
    lon, lat = preview.site.origin
    name = Path(preview.file).name
    axes.set_title(
        f"{name}: {x_max - x_min:.0f} m x {y_max - y_min:.0f} m about {lon:.5f}, {lat:.5f} (longitude, "
        f"latitude); {len(preview.site.buildings)} buildings",
        fontsize=10,
        parse_math=False,
    )
    outside_legend(figure, handles, "lower")
    if preview.attribution:
        axes.annotate(
            preview.attribution,
            (0.995, 0.005),
            xycoords="axes fraction",
            ha="right",
            va="bottom",
            fontsize=6.5,
            parse_math=False,
            path_effects=HALO,
            zorder=6,
        )
    return figure


def _draw_changes(axes: Axes, preview: Preview) -> list[Any]:
    """Draw what was added to the footprints of the file, what was removed, and which were repaired."""
    changes = preview.changes
    handles: list[Any] = []
    for area, colour, label in (
        (changes.added, ADDED, "filled: holes, yards, gaps"),
        (changes.removed, REMOVED, "left out: rim, too small, too thin"),
    ):
        if area.is_empty:
            continue
        rings = [np.asarray(part.exterior.coords) for part in area.geoms]
        style: dict[str, Any] = {"facecolor": colour, "edgecolor": colour, "alpha": 0.75, "linewidth": 0.8}
        axes.add_collection(PolyCollection(rings, **style, zorder=2.5), autolim=False)
        handles.append(Patch(**style, label=label))
    for polygon in changes.crossing:
        axes.plot(*np.asarray(polygon.exterior.coords).T, color=CROSSING, linewidth=1.6, zorder=2.8)
    if changes.crossing:
        handles.append(Line2D([], [], color=CROSSING, label="repaired: crossed itself"))
    return handles


def _draw_places(axes: Axes, preview: Preview) -> list[Any]:
    """Draw the sources with the radius of their cloud, and the drones; a cross where they cannot be."""
    places, handles = preview.places, []
    placed = [*preview.named(places), *preview.further]
    refused = [at for _, at in placed if preview.ground.problem(at)]
    axes.add_patch(Circle(places.release, preview.model.release_radius, color=RELEASE["color"], alpha=0.45, zorder=3))
    handles += axes.plot(*places.release, **RELEASE | {"markersize": 8}, zorder=4, label="release, with its radius")
    for _, place in preview.further:
        axes.plot(*place, **RELEASE | {"markersize": 6}, zorder=4)
    for drone in places.drones:
        line = axes.plot(*drone, **START, markeredgecolor=BELIEF_COLOUR, zorder=4)
    if places.drones:
        line[0].set_label("drone's start" if len(places.drones) == 1 else "drones' starts")
        handles += line
    if refused:
        inside = [_into(preview, at) for at in refused]
        handles += axes.plot(*zip(*inside, strict=True), **REFUSED, zorder=5, label="not free: dafw run would refuse")
    return handles


def _into(preview: Preview, place: Point) -> Point:
    """Return a place moved to the edge of the site if it is outside, so that it can be seen."""
    x_min, y_min, x_max, y_max = preview.site.bounds
    return float(np.clip(place[0], x_min, x_max)), float(np.clip(place[1], y_min, y_max))


def _draw_winds(axes: Axes, preview: Preview) -> list[Any]:
    """Draw where the winds of belief and truth blow to, in the upper left corner."""
    x_min, _, x_max, y_max = preview.site.bounds
    length = 0.05 * (x_max - x_min)
    handles: list[Any] = []
    corner = np.array([x_min + 1.6 * length, y_max - 1.6 * length])
    for role, words, speed, angle in preview.winds:
        colour = TRUTH_COLOUR if role == "truth" else BELIEF_COLOUR
        along = length * np.array([np.cos(angle), np.sin(angle)])
        arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 2.2}
        axes.annotate("", tuple(corner + along), tuple(corner - along), arrowprops=arrow, zorder=6)
        handles.append(Line2D([], [], color=colour, linewidth=2.2, label=f"wind, {words}: {speed:g} m/s"))
    return handles
