"""``dafw animate``: the maps of a run, moving, as a GIF or an MP4."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dafw.commands.parser import Parser
from dafw.core.errors import ConfigurationError


def animate_command(words: Sequence[str]) -> int:
    """Write the animations and print their paths; raises RunError if there is no run with a map."""
    parser = Parser(prog="dafw animate", description="Write an animation of a run: truth, belief and free run as maps.")
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="the folder of a run, or a run.nc")
    parser.add_argument(
        "-o", "--out", type=Path, metavar="FILE", help="FILE.gif or FILE.mp4; default: animation.gif in each folder"
    )
    parser.add_argument("--every", type=int, default=1, metavar="N", help="every Nth row is a frame; default: 1")
    parser.add_argument("--rate", type=int, default=10, metavar="N", help="frames a second; default: 10")
    asked = parser.parse_args(words)
    from dafw.views.animation import animate  # here, because they load matplotlib, which --help does not need
    from dafw.views.files import load_run

    if asked.out is not None and len(asked.runs) > 1:
        raise ConfigurationError(f"animate: --out is for one run, expected one RUN with it, got {len(asked.runs)}")
    for path in asked.runs:
        file = path / "run.nc" if path.is_dir() else path
        target = asked.out or file.with_name("animation.gif")
        print(animate(load_run(file), target, every=asked.every, rate=asked.rate), flush=True)
    return 0
