"""``dafw plot``: the pictures of a run, or of several together."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dafw.commands.parser import Parser


def plot_command(words: Sequence[str]) -> int:
    """Draw the pictures and print their paths; raises RunError if a path holds no run that can be read."""
    parser = Parser(prog="dafw plot", description="Draw the pictures of a run, or of several together.")
    parser.add_argument(
        "runs", nargs="+", type=Path, metavar="RUN", help="the folder of a run or of a multirun, or a run.nc"
    )
    parser.add_argument("--out", type=Path, help="folder for the pictures")
    asked = parser.parse_args(words)
    from dafw.views import draw_runs  # here, because it loads matplotlib, which --help does not need

    for path in draw_runs(asked.runs, asked.out):
        print(path)
    return 0
