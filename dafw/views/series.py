"""Curves over time: ERR of several runs (the paper's Fig. 3), the belief about scalars, and states without a map."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dafw.core.errors import RunError
from dafw.views.contents import has_free_run, is_angle, label, require, scalar_variables, scored_variable, time_units
from dafw.views.style import (
    BELIEF_COLOUR,
    FREE_COLOUR,
    TRUTH_COLOUR,
    colour_scale,
    new_figure,
    outside_legend,
    run_style,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from xarray import Dataset

GRID: dict[str, Any] = {"color": "0.9", "linewidth": 0.8}


def plot_errors(runs: Mapping[str, Dataset]) -> Figure:
    """Draw ERR in per cent over time of each run, and the free run dashed: once where all runs share it."""
    for run in runs.values():
        scored_variable(run)
    figure = new_figure(6.8, 4.4)
    axes = figure.subplots()
    handles: list[Line2D] = []
    longest = max(runs.values(), key=lambda run: run.sizes["time"])
    shared = all(_same_free_run(run, longest) for run in runs.values())
    for index, run in enumerate([longest] if shared else runs.values()):
        colour = FREE_COLOUR if shared else run_style(index, len(runs))["color"]
        axes.plot(run["time"].values, run["err_free"].values, "--", color=colour, linewidth=1.5, gid="free")
    for index, (text, run) in enumerate(runs.items()):
        time, err = run["time"].values, run["err"].values
        handles += axes.plot(time, err, **run_style(index, len(runs)), linewidth=1.8, label=text, gid="err")
    if any(has_free_run(run) for run in runs.values()):
        handles.append(Line2D([], [], color=FREE_COLOUR, linestyle="--", linewidth=1.5, label="free run"))
    _time_axis(axes, longest)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("ERR (%)")
    outside_legend(figure, handles, "upper")
    return figure


def plot_parameters(run: Dataset) -> Figure:
    """Draw truth, free run and belief about every scalar of the state, one panel each; angles in degrees, unwrapped.

    The band is the ensemble's standard deviation; members are drawn where the file has them. Raises RunError where
    the state has no scalar.
    """
    scored_variable(run)
    names = scalar_variables(run)
    if not names:
        raise RunError("a picture of parameters needs a scalar state variable, which this run does not have")
    figure = new_figure(6.8, 0.9 + 2.4 * len(names))
    panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for axes, name in zip(panels, names, strict=True):
        handles = _draw_scalar(axes, run, name)
        _time_axis(axes, run)
        axes.set_xlabel("")
    panels[-1].set_xlabel(f"t ({time_units(run)})")
    figure.align_ylabels(panels)
    outside_legend(figure, handles, "upper")
    return figure


def _draw_scalar(axes: Axes, run: Dataset, name: str) -> list[Artist]:
    """Draw one scalar and return its legend entries."""
    require(run, "a picture of parameters", f"{name}_free", f"{name}_spread")
    time, spread = run["time"].values, run[f"{name}_spread"].values
    truth, free, mean = (run[f"{name}_{suffix}"].values for suffix in ("truth", "free", "mean"))
    members = run[f"{name}_members"].values if f"{name}_members" in run else np.empty((time.size, 0))
    if angle := is_angle(run, name):
        truth = np.unwrap(truth)
        free, mean = unwrap_near(free, truth[0]), unwrap_near(mean, truth[0])
        members = mean[:, None] + _wrap(members - mean[:, None])
        truth, free, mean, members, spread = map(np.degrees, (truth, free, mean, members, spread))
    handles: list[Artist] = []
    if members.size:
        lines = axes.plot(time, members, color=BELIEF_COLOUR, linewidth=0.6, alpha=0.35, label="members", gid="member")
        handles.append(lines[0])
    handles.append(
        axes.fill_between(
            time, mean - spread, mean + spread, color=BELIEF_COLOUR, alpha=0.2, linewidth=0, label="± spread"
        )
    )
    handles += axes.plot(time, mean, color=BELIEF_COLOUR, linewidth=1.9, label="belief", gid="mean")
    if has_free_run(run):
        handles += axes.plot(time, free, "--", color=FREE_COLOUR, linewidth=1.5, label="free run", gid="free")
    handles += axes.plot(time, truth, color=TRUTH_COLOUR, linewidth=1.4, label="truth", gid="truth")
    axes.set_ylabel(label(run, name, "°" if angle else None))
    return handles


def plot_state(run: Dataset) -> Figure:
    """Draw truth and analysis mean of a state without coordinates: time upwards, index of the variable across.

    Raises RunError where the scored variable is a scalar or the run has only one time.
    """
    name = scored_variable(run)
    truth, mean = run[f"{name}_truth"].values, run[f"{name}_mean"].values
    if truth.ndim != 2 or len(truth) < 2:
        raise RunError(f"a picture of '{name}' over index and time needs several indices and two times")
    scale = colour_scale(truth, float(np.nanmax(truth)), truth, mean)
    figure = new_figure(8.0, 4.6)
    row = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, (title, values) in zip(row, {"Truth": truth, "Belief": mean}.items(), strict=True):
        picture = axes.pcolormesh(
            np.arange(values.shape[1]), run["time"].values, values, shading="nearest", rasterized=True, **scale.keywords
        )
        axes.set_title(title, fontsize=11)
        axes.set_xlabel("index")
    row[0].set_ylabel(f"t ({time_units(run)})")
    figure.colorbar(picture, ax=row, label=label(run, name), extend=scale.extend, pad=0.02)
    return figure


def unwrap_near(angles: np.ndarray, start: float) -> np.ndarray:
    """Return angles (time,) in radians without jumps of 2 pi, beginning within pi of ``start``."""
    unwrapped = np.unwrap(angles)
    return np.asarray(unwrapped + (start + _wrap(unwrapped[0] - start) - unwrapped[0]))


def _wrap(difference: np.ndarray) -> np.ndarray:
    return (difference + np.pi) % (2 * np.pi) - np.pi


def _same_free_run(run: Dataset, longest: Dataset) -> bool:
    """Say whether two runs agree in time and free run as far as the shorter goes."""
    length = run.sizes["time"]
    return all(
        np.array_equal(run[name].values, longest[name].values[:length], equal_nan=True) for name in ("time", "err_free")
    )


def _time_axis(axes: Axes, run: Dataset) -> None:
    time = run["time"].values
    if time[-1] > time[0]:
        axes.set_xlim(time[0], time[-1])
    axes.set_xlabel(f"t ({time_units(run)})")
    axes.grid(**GRID)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
