"""``dafw report``: a page in one file, which plays a run in a browser."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dafw.commands.parser import Parser


def report_command(words: Sequence[str]) -> int:
    """Write the page and print its path; raises RunError if there is no run that can be read."""
    parser = Parser(
        prog="dafw report",
        description="Write one HTML file that plays a run in a browser: maps, route, curves, configuration.",
    )
    parser.add_argument("run", type=Path, metavar="RUN", help="the folder of a run, or a run.nc")
    parser.add_argument("-o", "--out", type=Path, metavar="FILE", help="the file; default: report.html in the folder")
    asked = parser.parse_args(words)
    from dafw.views.report import write_report  # here, because it loads matplotlib, which --help does not need

    print(write_report(asked.run, asked.out))
    return 0
