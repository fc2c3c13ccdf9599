"""``dafw report``: a page in one file, which plays a run, or compares many, in a browser."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dafw.commands.parser import Parser
from dafw.core.errors import ConfigurationError


def report_command(words: Sequence[str]) -> int:
    """Write the pages and print their paths; raises RunError if there is nothing that can be read."""
    parser = Parser(
        prog="dafw report",
        description="Write one HTML file that shows a run, a study or a multirun in a browser, without any network.",
    )
    parser.add_argument(
        "places",
        nargs="+",
        type=Path,
        metavar="RUN",
        help="the folder of a run, of a study or of a multirun; or a run.nc",
    )
    parser.add_argument("-o", "--out", type=Path, metavar="FILE", help="the file; default: report.html in each folder")
    parser.add_argument(
        "--runs", action="store_true", help="of a study or a multirun: write the page of every run, too, and lead there"
    )
    asked = parser.parse_args(words)
    from dafw.studies.report_files import write_page  # here, because it loads matplotlib, which --help does not need

    if asked.out is not None and len(asked.places) > 1:
        raise ConfigurationError(f"report: --out is for one page, expected one RUN with it, got {len(asked.places)}")
    for place in asked.places:
        print(write_page(place, asked.out, runs=asked.runs), flush=True)
    return 0
