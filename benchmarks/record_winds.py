"""Print the winds that a run solved: ``python -m benchmarks.record_winds FOLDER > benchmarks/winds_of_a_run.csv``.

``FOLDER`` holds a run of the model ``ad_ins``. There is one line for each solve, in order: speed in m/s, direction in
radians, and the number (from 0) of the line with the member's wind before, empty for its first.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import TextIO

import numpy as np


def write(folder: Path, file: TextIO) -> int:
    """Write the winds of the belief's members; return how many."""
    from dafw.core.runs import open_run

    with open_run(folder) as run:
        names = ("model_wind_solved", "model_wind_speed", "model_wind_direction")
        solved, speed, direction = (run[name].transpose("time", "member").values for name in names)
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["intensity", "direction", "start"])
    last: dict[int, int] = {}
    count = 0
    for cycle, member in np.argwhere(solved == 1):
        writer.writerow(
            [repr(float(speed[cycle, member])), repr(float(direction[cycle, member])), last.get(member, "")]
        )
        last[member] = count
        count += 1
    return count


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit("usage: python -m benchmarks.record_winds FOLDER")
    write(Path(sys.argv[1]), sys.stdout)
