"""Colours and scales of all pictures; colour-blind readers can distinguish them, and zero is light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patheffects import Normal, Stroke

RUN_COLOURS = ("#D55E00", "#009E73", "#0072B2", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Red, green and blue first, as in the paper; Okabe and Ito's palette, doi:10.1038/nmeth.1618."""

TRUTH_COLOUR, FREE_COLOUR, BELIEF_COLOUR, REVISED_COLOUR = "black", "#7A7A7A", "#0072B2", "#D55E00"
SECTION_COLOUR = "#0050D0"
BUILDING_FACE, BUILDING_EDGE = "#C9CCD1", "#30343A"
RESOLUTION = 130
"""Dots per inch."""

HALO = [Stroke(linewidth=3.5, foreground="white"), Normal()]
"""A white outline that keeps a thin line visible on any background."""

_MAGMA = matplotlib.colormaps["magma_r"]
CONCENTRATION = LinearSegmentedColormap.from_list(
    "concentration", np.vstack([np.ones(4), _MAGMA(np.linspace(0.06, 0.92, 12))])
)
SPREAD = LinearSegmentedColormap.from_list(
    "spread", np.vstack([np.ones(4), matplotlib.colormaps["Greens"](np.linspace(0.1, 1.0, 12))])
)


def new_figure(width: float, height: float, *, maps: bool = False) -> Figure:
    """Return an empty figure, in inches, that keeps labels apart; ``maps`` packs axes of fixed aspect tightly."""
    return Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(wspace=0.05, compress=maps))


def run_style(index: int, runs: int) -> dict[str, Any]:
    """Return the line colour and style of one of several runs; a single run has the belief's blue."""
    if runs == 1:
        return {"color": BELIEF_COLOUR, "linestyle": "-"}
    # Dashes are reserved for the free run; beyond the last colour, line styles distinguish the runs.
    return {
        "color": RUN_COLOURS[index % len(RUN_COLOURS)],
        "linestyle": ("-", ":", "-.")[index // len(RUN_COLOURS) % 3],
    }


def outside_legend(figure: Figure, handles: Sequence[Artist], where: str, size: float = 1.0) -> None:
    """Put the legend outside the axes, ``upper`` or ``lower``, in as many columns as its longest entry allows.

    ``size`` is that of its texts, compared with the usual one.
    """
    longest = max(len(str(handle.get_label())) for handle in handles)
    letters = 14 if size == 1.0 else 11 / size  # in an inch; smaller letters leave less room for what stands between
    columns = max(1, min(6, round(letters * figure.get_figwidth()) // (longest + 5)))
    points = size * matplotlib.rcParams["font.size"]
    legend = figure.legend(
        handles=handles, loc=f"outside {where} center", ncols=columns, frameon=False, fontsize=points
    )
    legend.set_gid(where)


def time_axis(axes: Axes, time: np.ndarray, units: str) -> None:
    """Let curves over ``time`` (rows,) fill the width, on a light grid; without ``units`` the axis has no label."""
    if time[-1] > time[0]:
        axes.set_xlim(time[0], time[-1])
    if units:
        axes.set_xlabel(f"t ({units})")
    axes.grid(color="0.9", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


@dataclass(frozen=True)
class ColourScale:
    """One scale for all panels of a picture; ``extend`` as matplotlib's colour bar takes it."""

    colours: Colormap
    norm: Normalize
    extend: str

    @property
    def keywords(self) -> dict[str, Any]:
        """Return the keyword arguments for matplotlib's colouring functions."""
        return {"cmap": self.colours, "norm": self.norm}


def colour_scale(truth: np.ndarray, upper: float, *shown: np.ndarray) -> ColourScale:
    """Choose a scale for the arrays ``shown`` from the values of the ``truth``.

    For a concentration it goes from zero (white) to ``upper``, whatever the undershoots of the transport scheme. For a
    field with large negative values it goes from the smallest to the largest true value.
    """
    least, most = float(np.nanmin(truth)), float(np.nanmax(truth))
    if least < -0.25 * abs(most):
        colours, bottom, top = matplotlib.colormaps["viridis"], least, most
    else:
        colours, bottom, top = CONCENTRATION, 0.0, upper if upper > 0.0 else 1.0
    finite = [values for values in shown if np.isfinite(values).any()]
    above = any(np.nanmax(values) > top for values in finite)
    below = bottom < 0.0 and any(np.nanmin(values) < bottom for values in finite)
    extend = {(False, False): "neither", (True, False): "max", (False, True): "min", (True, True): "both"}[above, below]
    return ColourScale(colours, Normalize(bottom, top), extend)


def spread_scale(spread: np.ndarray) -> ColourScale:
    """Return the scale of a standard deviation; its colours differ from those of the variable itself."""
    most = float(np.nanmax(spread))
    return ColourScale(SPREAD, Normalize(0.0, most if most > 0.0 else 1.0), "neither")


def peak_at_end(truth: np.ndarray) -> float:
    """Return the maximum of the truth (time, node) at the last time, so that a decayed peak is still visible.

    It is at least a twentieth of the whole run's maximum, so that a cloud which has almost left the domain does not
    fill the scale.
    """
    return max(float(np.nanmax(truth[-1])), 0.05 * float(np.nanmax(truth)))


def draw_buildings(axes: Axes, outlines: list[np.ndarray]) -> None:
    """Draw buildings above the field and below routes."""
    axes.add_collection(
        PolyCollection(outlines, facecolor=BUILDING_FACE, edgecolor=BUILDING_EDGE, linewidth=0.7, zorder=2),
        autolim=False,
    )


def map_axes(axes: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """Give a map the same scale in both directions, and no empty border."""
    axes.set_aspect("equal")
    axes.set_xlim(x.min(), x.max())
    axes.set_ylim(y.min(), y.max())
