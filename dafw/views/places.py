"""Where a source is: the probability of its place, as a belief whose members have places says it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from dafw.core.errors import RunError
from dafw.views.contents import landmarks
from dafw.views.style import SPREAD, TRUTH_COLOUR, new_figure, outside_legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from xarray import Dataset

SHARES = (0.9, 0.5)
"""Probabilities of the regions that are outlined."""
CELLS = 160
"""Cells of the map along the longer side."""


def has_places(run: Dataset) -> bool:
    """Return whether the file holds every member's place of the source."""
    return {"release_x_members", "release_y_members"} <= set(run.variables)


def places_of(run: Dataset, row: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the members' places (N, 2) in m at a row of the file, and their weights (N,)."""
    places = np.column_stack([run[f"release_{axis}_members"].values[row] for axis in "xy"])
    weights = run["weight"].values[row] if "weight" in run.variables else np.full(len(places), np.nan)
    return places, np.where(np.isfinite(weights), weights, 1.0 / len(places))


def density(places: np.ndarray, weights: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the probability density (m,) in m^-2 at points (m, 2) of weighted places (N, 2).

    It is a sum of normal distributions about the places, with the covariance of all, and the width that suits a normal
    distribution best (Silverman 1986, Sec. 4.3).
    """
    size = 1.0 / float(weights @ weights)
    off = places - weights @ places
    covariance = (off.T * weights) @ off * size ** (-1.0 / 3.0) + 1e-6 * np.eye(2)
    root = np.linalg.cholesky(covariance)
    whitened, at = np.linalg.solve(root, places.T).T, np.linalg.solve(root, points.T).T
    squares = (at**2).sum(axis=1)[:, np.newaxis] + (whitened**2).sum(axis=1) - 2.0 * at @ whitened.T
    return np.asarray(np.exp(-0.5 * squares) @ weights / (2.0 * np.pi * np.prod(np.diag(root))))


def probability_within(run: Dataset, row: int, place: np.ndarray) -> float:
    """Return the probability of all places that are more likely than ``place`` (2,): it lies on that region's edge.

    A place is inside the 90 % region if this is less than 0.9.
    """
    places, weights = places_of(run, row)
    levels = density(places, weights, np.vstack([places, place]))
    return float(weights @ (levels[:-1] > levels[-1]))


def rows_shown(run: Dataset, count: int = 3) -> list[int]:
    """Return the rows at which the places' spread has fallen by equal factors, down to that of the last row."""
    spread = []
    for row in range(run.sizes["time"]):
        places, weights = places_of(run, row)
        spread.append(np.sqrt(weights @ ((places - weights @ places) ** 2).sum(axis=1)))
    first, last = max(spread[0], 1e-9), max(spread[-1], 1e-9)
    levels = [first * (last / first) ** (step / count) for step in range(1, count)]
    rows = [int(np.argmax(np.array(spread) <= level)) for level in levels]
    return sorted({*rows, run.sizes["time"] - 1})


MEAN: dict[str, Any] = {"marker": "+", "color": "#D55E00", "markersize": 9, "markeredgewidth": 1.6}
RELEASE: dict[str, Any] = {"marker": "x", "color": TRUTH_COLOUR, "markersize": 7}
PATH: dict[str, Any] = {"color": "0.45", "linewidth": 0.8}


def plot_places(run: Dataset) -> Figure:
    """Draw the density of the source's place at some times, with the regions that hold 50 and 90 % of it.

    Landmarks of the site are drawn, too; those called ``NAME from`` and ``NAME to`` are the ends of a line. Raises
    RunError if the run does not hold the members' places.
    """
    if not has_places(run):
        raise RunError("a map of the source's place needs the members' release_x and release_y, which this run lacks")
    rows = rows_shown(run)
    figure = new_figure(3.4 * len(rows) + 0.6, 4.3, maps=True)
    for axes, row in zip(figure.subplots(1, len(rows), squeeze=False)[0], rows, strict=True):
        _draw(axes, run, row)
        axes.set_title(f"t = {float(run['time'][row]):g} s", fontsize=10)
        axes.set_xlabel("x (m)")
    figure.axes[0].set_ylabel("y (m)")
    handles = [
        Patch(color=SPREAD(0.6), label="likely places"),
        Line2D([], [], color=TRUTH_COLOUR, linewidth=1.4, label="50 % lie inside"),
        Line2D([], [], color=TRUTH_COLOUR, linewidth=0.8, label="90 %"),
        Line2D([], [], **MEAN, linestyle="none", label="mean"),
    ]
    marks = landmarks(run)
    if "release" in marks:
        handles.append(Line2D([], [], **RELEASE, linestyle="none", label="the source"))
    if any(name.endswith(" from") for name in marks):
        handles.append(Line2D([], [], **PATH, label="path of a sensor"))
    outside_legend(figure, handles, "lower")
    return figure


def _draw(axes: Axes, run: Dataset, row: int) -> None:
    """Draw the map of one time."""
    places, weights = places_of(run, row)
    first = places_of(run, 0)[0]
    marks = landmarks(run)
    seen = np.vstack([first, *marks.values()])
    low, high = seen.min(axis=0), seen.max(axis=0)
    step = (high - low).max() / CELLS
    x, y = (np.arange(low[axis] + 0.5 * step, high[axis], step) for axis in range(2))
    points = np.stack(np.meshgrid(x, y), axis=-1)
    levels = density(places, weights, points.reshape(-1, 2)).reshape(points.shape[:2])
    axes.pcolormesh(x, y, levels, cmap=SPREAD, vmin=0.0, rasterized=True)
    total, ordered = levels.sum(), np.sort(levels.ravel())[::-1]
    edges = [ordered[min(np.searchsorted(np.cumsum(ordered), share * total), ordered.size - 1)] for share in SHARES]
    if edges[0] < edges[1]:
        axes.contour(x, y, levels, levels=edges, colors=TRUTH_COLOUR, linewidths=(0.8, 1.4))
    for name, place in marks.items():
        if name.endswith(" from") and (end := marks.get(f"{name.removesuffix(' from')} to")) is not None:
            axes.plot(*np.array([place, end]).T, **PATH, gid="path")
            axes.annotate(name.removesuffix(" from"), (end[0], end[1]), fontsize=7, color="0.35", ha="center", va="top")
    mean = weights @ places
    axes.plot(*mean, **MEAN, gid="mean")
    if "release" in marks:
        axes.plot(*marks["release"], **RELEASE, gid="release")
    axes.set_aspect("equal")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
