"""Animations of maps: truth, belief and free run side by side, with the vehicles' routes, as a GIF or an MP4."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dafw.core.errors import ConfigurationError, RunError
from dafw.core.progress import long_task
from dafw.views.contents import buildings, has_map, label, landmark, scored_variable, stage, time_units, triangulation
from dafw.views.maps import RELEASE, draw_field, height_to_width
from dafw.views.style import BELIEF_COLOUR, HALO, colour_scale, draw_buildings, map_axes, new_figure, peak_at_end

if TYPE_CHECKING:
    from xarray import Dataset

TITLES = {"truth": "Truth", "mean": "Belief", "free": "Free run"}
SCORES = {"mean": "err", "free": "err_free"}
DOTS = 100
"""Dots per inch; a map is ``INCHES`` wide."""
INCHES = 4.2

Drawing = Callable[[int], None]
"""Changes a picture so that it shows a row of the run."""


def animate(run: Dataset, file: Path, *, every: int = 1, rate: int = 10) -> Path:
    """Write an animation of a run's scored field and return the file; it appears complete or not at all.

    Args:
        run: as opened by ``open_run``, with a field on a mesh.
        file: its ending, ``.gif`` or ``.mp4``, is the format.
        every: every so many recorded rows, and the last one, are frames.
        rate: frames a second.

    Raises RunError if the run has no map, ConfigurationError for another ending or if there is no ffmpeg for an MP4.
    """
    if every < 1 or not 1 <= rate <= 50:
        raise ConfigurationError(f"animate: expected every >= 1 and 1 <= rate <= 50, got {every} and {rate}")
    file = Path(file)
    with _writer(file, rate) as writer:
        figure, draw = animated_figure(run)
        rows = rows_of(run)
        rows = np.unique(np.append(rows[::every], rows[-1]))
        # Beside the file, with its ending, which is the format.
        beside = file.with_name(f".{os.getpid()}.{file.name}")
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            with long_task("drawing frames", len(rows), "frame") as bar, writer.saving(figure, str(beside), DOTS):
                for row in rows:
                    draw(int(row))
                    writer.grab_frame()
                    bar.update()
            beside.replace(file)
        finally:
            beside.unlink(missing_ok=True)
    return file


def rows_of(run: Dataset) -> np.ndarray:
    """Return the rows (R,) of which the belief's field was recorded; raises RunError if the run has no map."""
    name = scored_variable(run)
    if not has_map(run):
        raise RunError(f"an animation needs a field on a mesh, which '{name}' of this run is not")
    return np.flatnonzero(np.isfinite(run[f"{name}_mean"].values).any(axis=1))


def animated_figure(run: Dataset) -> tuple[Figure, Drawing]:
    """Return a figure of the first recorded row, and what changes it; raises RunError if the run has no map."""
    rows, name = rows_of(run), scored_variable(run)
    fields = {key: values for key in TITLES if (values := stage(run, name, key)) is not None}
    reference = fields.get("truth", fields["mean"])[rows]
    scale = colour_scale(reference, peak_at_end(reference), *fields.values())
    mesh, outlines = triangulation(run), buildings(run)
    height = INCHES * height_to_width(mesh)
    figure = new_figure(INCHES * len(fields) + 0.9, height + 0.65, maps=True)
    parts: list[Drawing] = []
    grid = figure.subplots(1, len(fields), sharex=True, sharey=True, squeeze=False)
    for axes, (key, values) in zip(grid.flat, fields.items(), strict=True):
        coloured = draw_field(axes, mesh, values[rows[0]], scale)
        draw_buildings(axes, outlines)
        if (position := landmark(run, "release")) is not None:
            axes.plot(*position, **RELEASE | {"markersize": 6}, zorder=4)
        map_axes(axes, mesh.x, mesh.y)
        axes.set_xticks([])
        axes.set_yticks([])
        parts += [_field_drawing(coloured, values), _title_drawing(axes, run, key), *_routes(axes, run)]
    figure.colorbar(grid.flat[0].collections[0], ax=grid, label=label(run, name), extend=scale.extend, pad=0.01)
    heading = figure.suptitle(" ", fontsize=11)
    parts.append(lambda row: heading.set_text(f"t = {float(run['time'][row]):g} {time_units(run)}"))

    def draw(row: int) -> None:
        for part in parts:
            part(row)

    draw(int(rows[0]))
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # from now on nothing moves but what is shown
    return figure, draw


def _field_drawing(coloured: Any, values: np.ndarray) -> Drawing:
    return lambda row: coloured.set_array(values[row])


def _title_drawing(axes: Axes, run: Dataset, key: str) -> Drawing:
    """Return what shows the title of a map with its ERR, if there is one."""
    score = SCORES.get(key, "")
    errors = run[score].values if score in run.variables else np.full(run.sizes["time"], np.nan)

    def draw(row: int) -> None:
        known = f", ERR {errors[row]:.1f} %" if np.isfinite(errors[row]) else ""
        axes.set_title(TITLES[key] + known, fontsize=10.5)

    return draw


def _routes(axes: Axes, run: Dataset) -> list[Drawing]:
    """Return what shows the vehicles' routes so far, and where the vehicles are."""
    if "vehicle_x" not in run.variables or not run.sizes.get("vehicle"):
        return []
    found: list[Drawing] = []
    for x, y in zip(run["vehicle_x"].values.T, run["vehicle_y"].values.T, strict=True):
        (line,) = axes.plot([], [], color=BELIEF_COLOUR, linewidth=1.2, path_effects=HALO, zorder=3)
        (place,) = axes.plot([], [], "^", color="black", markeredgecolor="white", markersize=8, zorder=5)
        found.append(_route_drawing(line, place, x, y))
    return found


def _route_drawing(line: Any, place: Any, x: np.ndarray, y: np.ndarray) -> Drawing:
    def draw(row: int) -> None:
        line.set_data(x[: row + 1], y[: row + 1])
        place.set_data(x[row : row + 1], y[row : row + 1])

    return draw


@contextmanager
def _writer(file: Path, rate: int) -> Iterator[AbstractMovieWriter]:
    """Give what writes the frames in the format of the file's ending; raises ConfigurationError if nothing can."""
    if file.suffix == ".gif":
        yield PillowWriter(fps=rate)
        return
    if file.suffix != ".mp4":
        raise ConfigurationError(f"animate: expected a file that ends with .gif or .mp4, got {file.name}")
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        program = {"animation.ffmpeg_path": get_ffmpeg_exe()}
    except ImportError:
        program = {}
    with matplotlib.rc_context(program):
        if not FFMpegWriter.isAvailable():
            raise ConfigurationError("animate: an MP4 needs ffmpeg; it comes with: pip install 'dafw[video]'")
        yield FFMpegWriter(fps=rate, extra_args=["-pix_fmt", "yuv420p", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2"])
