"""``dafw plot``: the pictures of a run, or of several together."""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Sequence
from math import isfinite
from pathlib import Path

from dafw.commands.parser import Parser


def plot_command(words: Sequence[str]) -> int:
    """Draw the pictures and print their paths; raises RunError if a path holds no run that can be read."""
    parser = Parser(prog="dafw plot", description="Draw the pictures of a run, or of several together.")
    parser.add_argument(
        "runs", nargs="+", type=Path, metavar="RUN", help="the folder of a run or of a multirun, or a run.nc"
    )
    parser.add_argument("--out", type=Path, help="folder for the pictures")
    parser.add_argument("--format", default="png", metavar="png|pdf|svg", help="default: png")
    parser.add_argument("--width", type=float, metavar="MM", help="width of every picture in mm, such as a column's 85")
    parser.add_argument(
        "--times",
        type=_times,
        default=(),
        metavar="T,T,...",
        help="of one run: only its maps at these times, in s, with the difference of belief and truth",
    )
    asked = parser.parse_args(words)
    from dafw.views import draw_runs  # here, because it loads matplotlib, which --help does not need
    from dafw.views.printing import Paper

    for path in draw_runs(asked.runs, asked.out, Paper(asked.format, asked.width), asked.times):
        print(path)
    return 0


def _times(text: str) -> tuple[float, ...]:
    try:
        times = tuple(map(float, text.split(",")))
    except ValueError:
        times = ()
    if not times or not all(map(isfinite, times)):
        raise ArgumentTypeError(f"expected times in s such as 30,60, got {text!r}")
    return times
