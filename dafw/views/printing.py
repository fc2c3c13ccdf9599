"""Pictures for print: a format, and the width of a column."""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from typing import Any, BinaryIO

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import Collection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import Normal, Stroke
from matplotlib.text import Text
from PIL import Image

from dafw.core.errors import ConfigurationError
from dafw.views.style import RESOLUTION, outside_legend

FORMATS = ("png", "pdf", "svg")
NARROWEST, WIDEST = 40.0, 1000.0
"""Millimetres."""
LEAST = 5.5
"""Points of the smallest text in a narrow picture."""
PRINT_RESOLUTION = 300
"""Dots per inch of what is made of dots in a picture with a stated width."""
PACKED = 3
"""How hard a PNG is compressed: 0 to 9. It is a seventh larger than with 6, and compressed twice as fast."""
EDGE = 0.08
"""Inches that are left beside what is drawn where empty edges are cut off."""
WITHOUT_DATE: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
"""So that the same run gives the same bytes."""


@dataclass(frozen=True)
class Paper:
    """What pictures are made for: a format, and a width in mm; None leaves every picture its own width."""

    format: str = "png"
    width: float | None = None

    def __post_init__(self) -> None:
        if self.format not in FORMATS:
            raise ConfigurationError(f"plot: expected a format of {', '.join(FORMATS)}, got {self.format!r}")
        if self.width is not None and not NARROWEST <= self.width <= WIDEST:
            raise ConfigurationError(
                f"plot: expected a width between {NARROWEST:g} and {WIDEST:g} mm, got {self.width:g}"
            )

    def write(self, figure: Figure, stream: BinaryIO) -> None:
        """Write a picture. Only maps leave empty edges, which are cut off unless a width is stated."""
        edges = self.width is None and any(axes.get_aspect() != "auto" for axes in figure.axes)
        dots = RESOLUTION if self.width is None else PRINT_RESOLUTION
        if self.format == "png":
            pixels = _pixels(figure, dots)
            Image.fromarray(_with_edges(pixels, round(EDGE * dots)) if edges else pixels).save(
                stream, format="png", compress_level=PACKED, dpi=(dots, dots)
            )
            return
        cut: dict[str, Any] = {"bbox_inches": "tight", "pad_inches": EDGE} if edges else {}
        # The names of parts in an SVG are random without a salt.
        with matplotlib.rc_context({"svg.hashsalt": "dafw"}):
            figure.savefig(stream, format=self.format, dpi=dots, metadata=WITHOUT_DATE[self.format], **cut)


SCREEN = Paper()
"""As pictures are without any option."""


def _pixels(figure: Figure, dots: int) -> np.ndarray:
    """Return the picture (rows, columns, 3) with so many dots per inch; what is transparent is white."""
    ground = matplotlib.rcParams["savefig.facecolor"]
    before = figure.dpi, figure.get_facecolor(), figure.canvas
    try:
        figure.dpi = dots
        figure.set_facecolor(before[1] if ground == "auto" else ground)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        drawn = np.asarray(canvas.buffer_rgba())
    finally:
        figure.dpi = before[0]
        figure.set_facecolor(before[1])
        figure.set_canvas(before[2])
    colours, cover = drawn[..., :3], drawn[..., 3:]
    if (cover < 255).any():
        colours = np.round(255.0 + (colours - 255.0) * (cover / 255.0)).astype(np.uint8)
    return np.ascontiguousarray(colours)


def _with_edges(pixels: np.ndarray, width: int) -> np.ndarray:
    """Return what is drawn in pixels (rows, columns, 3), with empty edges of a width.

    To let matplotlib find the edges it would have to draw the figure twice: six pictures take a sixth longer.
    """
    drawn = (pixels != pixels[0, 0]).any(axis=2)
    if not drawn.any():
        return pixels
    (top, bottom), (left, right) = (np.flatnonzero(drawn.any(axis=axis))[[0, -1]] for axis in (1, 0))
    rows, columns = bottom + 1 - top, right + 1 - left
    framed = np.empty((rows + 2 * width, columns + 2 * width, 3), dtype=pixels.dtype)
    framed[:] = pixels[0, 0]
    framed[width : width + rows, width : width + columns] = pixels[top : bottom + 1, left : right + 1]
    return framed


def fit(figure: Figure, width: float) -> None:
    """Give a picture a width in mm; if it becomes narrower, its texts, lines and marks become smaller, but less so."""
    factor = width / 25.4 / figure.get_figwidth()
    smaller = min(1.0, factor**0.5)
    # Texts keep more of their height than the rest does.
    figure.set_size_inches(width / 25.4, figure.get_figheight() * factor / min(1.0, factor**0.2))
    if smaller < 1.0:
        _shrink(figure, smaller)
    figure.draw_without_rendering()
    for axes in figure.get_axes():
        _break(axes.title, max(axes.bbox.width, 0.9 * figure.bbox.width if len(figure.get_axes()) == 1 else 0.0))
    if figure.get_suptitle():
        _break(figure._suptitle, figure.bbox.width)  # type: ignore[attr-defined]  # it has no public name


def _shrink(figure: Figure, smaller: float) -> None:
    """Make texts, lines and marks smaller by a factor."""
    for text in figure.findobj(Text):
        text.set_fontsize(max(LEAST, smaller * float(text.get_fontsize())))
    strokes: list[Any] = [*figure.findobj(Line2D), *figure.findobj(Patch)]
    for drawn in strokes:
        drawn.set_linewidth(smaller * drawn.get_linewidth())
        if drawn.get_path_effects():
            drawn.set_path_effects([Stroke(linewidth=drawn.get_linewidth() + 1.2, foreground="white"), Normal()])
    for line in figure.findobj(Line2D):
        line.set_markersize(smaller * line.get_markersize())
        line.set_markeredgewidth(smaller * line.get_markeredgewidth())
    for collection in figure.findobj(Collection):
        collection.set_linewidth([smaller * width for width in np.atleast_1d(collection.get_linewidth())])
    for axes in figure.get_axes():
        axes.tick_params(labelsize=max(LEAST, smaller * 10.0), width=0.8 * smaller, length=3.5 * smaller)
    for legend in list(figure.legends):
        if legend.get_gid() in ("upper", "lower"):  # anew, because its columns depend on its width
            handles = [handle for handle in legend.legend_handles if handle is not None]
            for handle, text in zip(handles, legend.get_texts(), strict=True):
                handle.set_label(text.get_text())
            legend.remove()
            outside_legend(figure, handles, str(legend.get_gid()), smaller)


def _break(title: Text, width: float) -> None:
    """Break a title into lines where it is wider than so many pixels."""
    words = title.get_text().split()
    if len(words) > 1 and "$" not in title.get_text() and title.get_window_extent().width > width:
        letters = max(8, int(len(title.get_text()) * width / title.get_window_extent().width))
        title.set_text(_in_lines(title.get_text(), letters))


def _in_lines(text: str, letters: int) -> str:
    """Return a text in lines of at most so many letters, broken where it has a pause if that will do.

    >>> _in_lines("Belief, t = 100 s (ERR 39 %)", 20)
    'Belief, t = 100 s\\n(ERR 39 %)'
    """
    for pause in (r" (?=\()", r"(?<=[,;]) "):
        for found in reversed(list(re.finditer(pause, text))):
            lines = text[: found.start()], text[found.end() :]
            if max(map(len, lines)) <= letters:
                return "\n".join(lines)
    return textwrap.fill(text, letters)
