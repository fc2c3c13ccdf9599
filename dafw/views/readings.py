"""Readings of a file: a map of what was read along the way, and the same over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from dafw.plugins.readings.files.placing import in_plane, plane_origin
from dafw.plugins.readings.files.table import Table
from dafw.views.style import BELIEF_COLOUR, colour_scale, new_figure, time_axis

if TYPE_CHECKING:
    from dafw.plugins.readings.recorded import Recorded

PAUSE = 120.0
"""Seconds without a reading after which another map begins."""
MOST = 4
"""Maps that are drawn at most; the last one has all that is left."""


def places_in_metres(table: Table, kind: str | None, origin: tuple[float, float] | None) -> np.ndarray:
    """Return places (R, 2) in m; raises ReadingsError if readings have none."""
    if kind == "metres":
        return in_plane(table, None)
    if kind != "degrees" or origin is None:
        raise table.error("a map needs columns x and y, or lon and lat")
    return in_plane(table, origin)


def parts_of(time: np.ndarray) -> list[np.ndarray]:
    """Return the indices of ascending times (R,) in parts, between which there are pauses."""
    longest = np.sort(np.flatnonzero(np.diff(time) > PAUSE))[: MOST - 1]
    return [part for part in np.split(np.arange(len(time)), longest + 1) if part.size]


def plot_readings(source: Recorded) -> Figure:
    """Draw the readings that a study could use, less their background: maps, one for each part, and curves over time.

    Places are metres about the option ``origin``; without it, about the place of the first reading. Raises
    ReadingsError if the file cannot be used, or if its readings have no places in the plane.
    """
    usable = source.usable
    table = usable.table
    if not len(table):
        raise source.rows.error("there are no readings to draw")
    about = source.plane_origin
    if usable.kind == "degrees" and about is None:
        about = plane_origin(source.rows, "first")
    places = places_in_metres(table, usable.kind, about)
    value, time = table.number("value"), table.number("time")
    scale = colour_scale(np.maximum(value, 0.0), float(np.percentile(value, 99.0)), value)
    parts = parts_of(time)
    figure = new_figure(3.1 * len(parts) + 1.6, 6.0)
    maps, curves = figure.subplots(2, len(parts), squeeze=False, height_ratios=[2, 1])
    low, high = places.min(axis=0), places.max(axis=0)
    edge = 0.04 * max(float((high - low).max()), 1.0)
    for part, axes, below in zip(parts, maps, curves, strict=True):
        axes.plot(*places[part].T, color="0.8", linewidth=0.8, zorder=1)
        rows = part[np.argsort(value[part], kind="stable")]  # the highest on top
        x, y = places[rows].T
        axes.scatter(x, y, s=16, c=value[rows], cmap=scale.colours, norm=scale.norm, linewidths=0.2, edgecolors="0.4")
        axes.set_aspect("equal")
        axes.set_xlim(low[0] - edge, high[0] + edge)
        axes.set_ylim(low[1] - edge, high[1] + edge)
        axes.set_xlabel("x (m)")
        below.plot(time[part], value[part], color=BELIEF_COLOUR, linewidth=0.9)
        below.set_ylim(value.min(), value.max())
        time_axis(below, time[part], "s")
    maps[0].set_ylabel("y (m)")
    said = _named(source)
    curves[0].set_ylabel(said)
    figure.colorbar(ScalarMappable(scale.norm, scale.colours), ax=maps, label=said, extend=scale.extend)
    return figure


def _named(source: Recorded) -> str:
    """Return what the values are, for an axis."""
    name = source.rows.names.get("value", "value")
    return name if not source.background else f"{name}\nless {source.background:g}"
