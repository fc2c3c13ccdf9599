"""What every sensor read, what was expected of it, and the background that it is believed to have."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dafw.core.errors import RunError
from dafw.views.contents import label, scored_variable, time_units
from dafw.views.style import BELIEF_COLOUR, FREE_COLOUR, HALO, TRUTH_COLOUR, new_figure, outside_legend, time_axis

if TYPE_CHECKING:
    from xarray import Dataset


DROPPED = 2
"""The flag of ``observation_use`` of readings that the filter was not given, such as those from before the start."""


def has_expected(run: Dataset) -> bool:
    """Return whether the filter told what it expected of every sensor."""
    if "filter_expected" not in run.variables:
        return False
    return {"observation_sensor", "sensor_name"} <= set(run.variables) or len(sensors_expected(run)) == 1


def sensors_expected(run: Dataset) -> list[str]:
    """Return the names of the sensors (n,) in the order of ``filter_expected``."""
    told = str(run["filter_expected"].attrs.get("long_name", ""))
    return told.removeprefix("what was expected of the sensors ").split(", ")


def read_by(run: Dataset, sensor: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the row and the value of a sensor's readings that were not dropped, both (m,).

    In a run without names of sensors these are all readings.
    """
    values = run["observation_value"].values
    if "sensor_name" in run.variables:
        names = [str(name) for name in run["sensor_name"].values]
        if sensor not in names:
            return np.empty(0, dtype=int), np.empty(0)
        its = run["observation_sensor"].values == names.index(sensor)
    else:
        its = np.isfinite(values)
    if "observation_use" in run.variables:
        its = its & (run["observation_use"].values != DROPPED)
    rows, columns = np.nonzero(its)
    return rows, values[rows, columns]


def plot_expected(run: Dataset) -> Figure:
    """Draw, for every sensor, readings as dots, and what was expected before they came as a line.

    Raises RunError if the filter did not tell what it expected.
    """
    if not has_expected(run):
        raise RunError("a picture of expected readings needs a filter with backgrounds, which this run lacks")
    names = sensors_expected(run)
    figure = new_figure(7.4, 1.15 * len(names) + 0.9)
    panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    time = run["time"].values
    for number, (axes, name) in enumerate(zip(panels, names, strict=True)):
        rows, values = read_by(run, name)
        axes.plot(time[rows], values, ".", color=TRUTH_COLOUR, markersize=3.5, gid="read")
        axes.plot(time, run["filter_background"].values[:, number], color=FREE_COLOUR, linewidth=1.0, gid="background")
        axes.plot(time, run["filter_expected"].values[:, number], color=BELIEF_COLOUR, linewidth=1.3, gid="expected")
        axes.text(
            0.008, 0.94, name, transform=axes.transAxes, ha="left", va="top", fontweight="bold", path_effects=HALO
        )
        time_axis(axes, time, time_units(run) if axes is panels[-1] else "")
    handles = [
        Line2D([], [], color=TRUTH_COLOUR, marker=".", linestyle="none", label="read"),
        Line2D([], [], color=BELIEF_COLOUR, label="expected before it was read"),
        Line2D([], [], color=FREE_COLOUR, label="background"),
    ]
    figure.supylabel(label(run, scored_variable(run)), fontsize=10)
    outside_legend(figure, handles, "upper")
    return figure
