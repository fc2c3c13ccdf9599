"""Curves over time: ERR of several runs (the paper's Fig. 3), the belief about scalars, and states without a map."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from dafw.core.errors import RunError
from dafw.views.contents import (
    has_free_run,
    has_revised_errors,
    has_truth,
    is_angle,
    is_positive,
    label,
    require,
    scalar_variables,
    scored_variable,
    stage,
    time_units,
)
from dafw.views.style import (
    BELIEF_COLOUR,
    FREE_COLOUR,
    REVISED_COLOUR,
    TRUTH_COLOUR,
    colour_scale,
    new_figure,
    outside_legend,
    run_style,
    time_axis,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from xarray import Dataset


def plot_errors(runs: Mapping[str, Dataset]) -> Figure:
    """Draw each run's ERR in per cent over time; beliefs revised later as thinner lines, the free run dashed.

    The free run is drawn once if all runs have the same. Runs without a truth are left out; raises RunError if no run
    has one.
    """
    styles = {text: run_style(index, len(runs)) for index, text in enumerate(runs)}
    scored = {text: run for text, run in runs.items() if has_truth(run)}
    if not scored:
        raise RunError(f"a picture of ERR needs a truth, which {', '.join(runs)} does not have")
    figure = new_figure(6.8, 4.4)
    axes = figure.subplots()
    handles: list[Line2D] = []
    longest = max(scored.values(), key=lambda run: run.sizes["time"])
    with_free = {text: run for text, run in scored.items() if has_free_run(run)}
    shared = len(with_free) == len(scored) and all(_same_free_run(run, longest) for run in scored.values())
    for text, run in with_free.items():
        if run is longest or not shared:
            colour = FREE_COLOUR if shared else styles[text]["color"]
            axes.plot(run["time"].values, run["err_free"].values, "--", color=colour, linewidth=1.5, gid="free")
    revised = {text: run for text, run in scored.items() if has_revised_errors(run)}
    for text, run in revised.items():
        colour = REVISED_COLOUR if len(runs) == 1 else styles[text]["color"]
        axes.plot(run["time"].values, run["err_smoothed"].values, color=colour, linewidth=1.0, gid="smoothed")
    for text, run in scored.items():
        handles += axes.plot(
            run["time"].values, run["err"].values, **styles[text], linewidth=1.8, label=text, gid="err"
        )
    if revised:
        colour = REVISED_COLOUR if len(runs) == 1 else FREE_COLOUR
        handles.append(Line2D([], [], color=colour, linewidth=1.0, label="as revised later"))
    if with_free:
        handles.append(Line2D([], [], color=FREE_COLOUR, linestyle="--", linewidth=1.5, label="free run"))
    time_axis(axes, longest["time"].values, time_units(longest))
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("ERR (%)")
    outside_legend(figure, handles, "upper")
    return figure


def plot_parameters(run: Dataset) -> Figure:
    """Draw truth, free run and belief about every scalar of the state, one panel each; angles in degrees, unwrapped.

    The band is the ensemble's standard deviation. Members, the free run, the truth and the belief as revised later are
    drawn if the file has them. Raises RunError if the state has no scalar.
    """
    scored_variable(run)
    names = scalar_variables(run)
    if not names:
        raise RunError("a picture of parameters needs a scalar state variable, which this run does not have")
    figure = new_figure(6.8, 0.9 + 2.4 * len(names))
    panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    handles: dict[str, Artist] = {}
    for axes, name in zip(panels, names, strict=True):
        handles |= {str(handle.get_label()): handle for handle in _draw_scalar(axes, run, name)}
        time_axis(axes, run["time"].values, "")
    panels[-1].set_xlabel(f"t ({time_units(run)})")
    figure.align_ylabels(panels)
    outside_legend(figure, list(handles.values()), "upper")
    return figure


def _draw_scalar(axes: Axes, run: Dataset, name: str) -> list[Artist]:
    """Draw one scalar and return its legend entries."""
    require(run, "a picture of parameters", f"{name}_spread")
    time, mean, spread = run["time"].values, run[f"{name}_mean"].values, run[f"{name}_spread"].values
    stages = {suffix: stage(run, name, suffix) for suffix in ("smoothed_mean", "free", "truth")}
    curves = {suffix: values for suffix, values in stages.items() if values is not None}
    members = run[f"{name}_members"].values if f"{name}_members" in run else np.empty((time.size, 0))
    if angle := is_angle(run, name):
        start = curves.get("truth", mean)[0]
        mean = unwrap_near(mean, start)
        members = np.degrees(mean[:, None] + _wrap(members - mean[:, None]))
        curves = {suffix: np.degrees(unwrap_near(values, start)) for suffix, values in curves.items()}
        mean, spread = np.degrees(mean), np.degrees(spread)
    handles: list[Artist] = []
    if members.size:
        lines = axes.plot(time, members, color=BELIEF_COLOUR, linewidth=0.6, alpha=0.35, label="members", gid="member")
        handles.append(lines[0])
    low, high = mean - spread, mean + spread
    if is_positive(run, name):
        low, high = mean * np.exp(-spread), mean * np.exp(spread)
    handles.append(
        axes.fill_between(time, low, high, color=BELIEF_COLOUR, alpha=0.2, linewidth=0, label="± spread", gid="band")
    )
    handles += axes.plot(time, mean, color=BELIEF_COLOUR, linewidth=1.9, label="belief", gid="mean")
    styles: dict[str, dict[str, Any]] = {
        "smoothed_mean": {"color": REVISED_COLOUR, "linewidth": 1.4, "label": "as revised later", "gid": "smoothed"},
        "free": {"color": FREE_COLOUR, "linewidth": 1.5, "linestyle": "--", "label": "free run", "gid": "free"},
        "truth": {"color": TRUTH_COLOUR, "linewidth": 1.4, "label": "truth", "gid": "truth"},
    }
    for suffix, values in curves.items():
        handles += axes.plot(time, values, **styles[suffix])
    axes.set_ylabel(label(run, name, "°" if angle else None))
    return handles


def plot_state(run: Dataset) -> Figure:
    """Draw truth and analysis mean of a state without coordinates: time on the vertical axis, index on the horizontal.

    Without a truth only the belief is drawn. Raises RunError if the scored variable is a scalar or the run has only one
    time.
    """
    name = scored_variable(run)
    truth, mean = stage(run, name, "truth"), run[f"{name}_mean"].values
    if mean.ndim != 2 or len(mean) < 2:
        raise RunError(f"a picture of '{name}' over index and time needs several indices and two times")
    panels = {"Belief": mean} if truth is None else {"Truth": truth, "Belief": mean}
    reference = mean if truth is None else truth
    scale = colour_scale(reference, float(np.nanmax(reference)), *panels.values())
    figure = new_figure(8.0 if truth is not None else 5.2, 4.6)
    row = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (title, values) in zip(row, panels.items(), strict=True):
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
    """Return whether two runs have the same times and free run, over the length of the shorter run."""
    length = run.sizes["time"]
    return all(
        np.array_equal(run[name].values, longest[name].values[:length], equal_nan=True) for name in ("time", "err_free")
    )
