"""``dafw watch``: the page of a run that is still going on, served on this machine, which follows the run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dafw.commands.parser import Parser
from dafw.studies.stopping import stop_signals


def watch_command(words: Sequence[str]) -> int:
    """Serve the page until Ctrl-C, which ends it with exit status 0; raises RunError if there is no such folder."""
    parser = Parser(
        prog="dafw watch",
        description="Show a run in a browser while it goes on. Only this machine can see the page; Ctrl-C ends it.",
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="the folder of a run")
    parser.add_argument("--port", type=int, default=0, help="the port; default: one that is free")
    asked = parser.parse_args(words)
    from dafw.views.watch import watch  # here, because it loads matplotlib, which --help does not need

    with stop_signals():
        watch(asked.run, asked.port)
    return 0
