"""The concentration over time along the polyline gamma(s) (the paper's Fig. 5)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.tri import Triangulation

from dafw.core.errors import RunError
from dafw.core.interpolation import arc_lengths, in_triangles, points_along
from dafw.views.contents import has_section, label, polyline, scored_variable, stage, time_units, triangulation
from dafw.views.style import BUILDING_FACE, colour_scale, new_figure, outside_legend

if TYPE_CHECKING:
    from xarray import Dataset

SAMPLES = 251
"""Points along a section."""


def plot_section(run: Dataset) -> Figure:
    """Draw the scored variable along gamma over time for the truth, the free run and the belief, if recorded.

    They share one colour scale. Rows where gamma crosses a building or leaves the mesh are grey. Raises RunError if the
    run has no section, no field on a mesh, or only one time.
    """
    name = scored_variable(run)
    if not has_section(run):
        raise RunError(
            "a section needs section_x, section_y, a field on a mesh in all of two or more rows, which this run lacks"
        )
    arc_length, points = sample_polyline(polyline(run, "section"), SAMPLES)
    weights = SectionWeights(triangulation(run), points)
    stages = {"Truth": "truth", "Free run": "free", "Belief": "mean"}
    values = {title: stage(run, name, suffix) for title, suffix in stages.items()}
    panels = {title: weights.apply(field) for title, field in values.items() if field is not None}
    reference = panels.get("Truth", panels["Belief"])
    if not np.isfinite(reference).any():
        raise RunError("the section lies outside the mesh or inside buildings: nothing to draw along it")
    scale = colour_scale(reference, float(np.nanpercentile(reference, 99.9)), *panels.values())

    figure = new_figure(max(6.8, 1.4 + 3.0 * len(panels)), 3.9)
    row = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (title, along) in zip(row, panels.items(), strict=True):
        picture = axes.pcolormesh(
            run["time"].values, arc_length, along.T, shading="nearest", rasterized=True, **scale.keywords
        )
        axes.set_facecolor(BUILDING_FACE)
        axes.set_title(title, fontsize=11)
        axes.set_xlabel(f"t ({time_units(run)})")
    row[0].set_ylabel("arc length s along γ (m)")
    figure.colorbar(picture, ax=row, label=label(run, name), extend=scale.extend, pad=0.02)
    if not np.isfinite(reference).all():
        outside_legend(figure, [Patch(color=BUILDING_FACE, label="inside a building or outside the mesh")], "lower")
    return figure


def sample_polyline(corners: np.ndarray, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return ``samples`` equidistant arc lengths (samples,) and their points (samples, 2) along ``corners`` (k, 2)."""
    arc_length = np.linspace(0.0, arc_lengths(corners)[-1], samples)
    return arc_length, points_along(corners, arc_length)


class SectionWeights:
    """Linear interpolation from the nodes of a mesh to fixed points; computed once, applied to every time."""

    def __init__(self, mesh: Triangulation, points: np.ndarray) -> None:
        nodes = np.column_stack([mesh.x, mesh.y])
        inside, self.corners, self.weights = in_triangles(nodes, mesh.triangles, points)
        self.weights[~inside] = np.nan

    def apply(self, values: np.ndarray) -> np.ndarray:
        """Return (time, points) from (time, node); NaN outside the mesh."""
        return np.asarray(np.einsum("tpk,pk->tp", values[:, self.corners], self.weights))
