"""``dafw score``: the error of a live run's belief, found afterwards from the truth of its simulation."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from dafw.commands.parser import Parser


def score_command(words: Sequence[str]) -> int:
    """Print the scores of a run; raises RunError."""
    parser = Parser(prog="dafw score", description="Compare a live run's belief with the truth of its simulation.")
    parser.add_argument("run", type=Path, help="the folder of a run, or its run.nc")
    parser.add_argument("--truth", type=Path, metavar="FILE", help="the truth; by default truth.nc in the run's folder")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")
    asked = parser.parse_args(words)
    from dafw.studies.truth_file import scores_of

    found = scores_of(asked.run, asked.truth)
    if asked.json:
        print(json.dumps(found))
        return 0
    free = f", the free run's {found['err_free'][-1]:.2f} %" if "err_free" in found else ""
    print(f"t = {found['time'][-1]:g} s: the belief's ERR is {found['err'][-1]:.2f} %{free}")
    for name, values in found["parameters"].items():
        print(f"  {name:<16} truth {values['truth']:.4g}, belief {values['mean']:.4g} +- {values['spread']:.2g}")
    return 0
