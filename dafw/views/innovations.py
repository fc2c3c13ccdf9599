"""The normalised innovations over time: they judge a belief by its readings, with or without a truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from dafw.core.errors import RunError
from dafw.views.contents import has_innovations, time_units
from dafw.views.style import FREE_COLOUR, new_figure, outside_legend, run_style, time_axis

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from xarray import Dataset

LATEST = 20
"""The number of cycles with readings that a point of the curves covers."""


def plot_innovations(runs: Mapping[str, Dataset]) -> Figure:
    """Draw root mean square and mean of the normalised innovations of each run over time.

    An innovation, the reading minus its prediction, is divided by the standard deviation that the belief predicts for
    it. If the spread of the belief matches its error, the root mean square is near 1 and the mean near 0. A dot is one
    cycle. One reading says little, so the curves combine all readings of the last ``LATEST`` cycles with readings. Runs
    without readings are left out; raises RunError if no run has any.
    """
    styles = {text: run_style(index, len(runs)) for index, text in enumerate(runs)}
    read = {text: run for text, run in runs.items() if has_innovations(run)}
    if not read:
        raise RunError(f"a picture of innovations needs readings, which {', '.join(runs)} does not have")
    figure = new_figure(6.8, 5.2)
    upper, lower = figure.subplots(2, 1, sharex=True)
    handles: list[Line2D] = []
    for text, run in read.items():
        handles += _draw(upper, run, "innovation_rms", styles[text], text)
        _draw(lower, run, "innovation_mean", styles[text], text)
    longest = max(read.values(), key=lambda run: run.sizes["time"])
    for axes, level in ((upper, 1.0), (lower, 0.0)):
        axes.axhline(level, color=FREE_COLOUR, linestyle="--", linewidth=1.2, zorder=1, gid="honest")
        time_axis(axes, longest["time"].values, time_units(longest) if axes is lower else "")
    if max(float(np.nanmax(run["innovation_rms"].values)) for run in read.values()) > 10.0:
        upper.set_yscale("log")
        lower.set_yscale("symlog", linthresh=1.0)
        for axes in (upper, lower):  # as plain numbers: formulas such as 10^2 take long to lay out
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        upper.set_ylim(bottom=0.0)
    upper.set_ylabel("root mean square")
    lower.set_ylabel("mean")
    figure.align_ylabels([upper, lower])
    handles.append(Line2D([], [], color=FREE_COLOUR, linestyle="--", linewidth=1.2, label="of an honest belief"))
    handles.append(Line2D([], [], color=FREE_COLOUR, marker=".", markersize=4, linestyle="none", label="one cycle"))
    title = f"Innovations over their expected standard deviation; curves: latest {LATEST} cycles with readings"
    upper.set_title(title, fontsize=9.5)
    outside_legend(figure, handles, "upper")
    return figure


def recent(run: Dataset, name: str) -> np.ndarray:
    """Return (time,) an innovation score of all readings of the last ``LATEST`` cycles with readings, NaN elsewhere.

    Every cycle is weighted by its number of readings.
    """
    scores = run[name].values
    found = np.flatnonzero(np.isfinite(scores))
    power = 2 if name == "innovation_rms" else 1
    counts = np.isfinite(run["observation_forecast_mean"].values).sum(axis=1)[found]
    sums, readings = (
        np.convolve(terms, np.ones(LATEST))[: found.size] for terms in (counts * scores[found] ** power, counts)
    )
    values = np.full(scores.shape, np.nan)
    values[found] = (sums / readings) ** (1.0 / power)
    return values


def _draw(axes: Axes, run: Dataset, name: str, style: dict[str, Any], text: str) -> list[Line2D]:
    """Draw one score of one run: a dot for each cycle with readings, and the curve through them."""
    time, scores = run["time"].values, run[name].values
    found = np.isfinite(scores)
    axes.plot(time[found], scores[found], ".", color=style["color"], markersize=4, alpha=0.4, gid="cycles")
    return axes.plot(time[found], recent(run, name)[found], **style, linewidth=1.8, label=text, gid="recent")
