"""The memory of a run that records every member does not grow with its cycles."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import re, sys
from pathlib import Path
import dafw
from dafw.plugins.filters.none import NoFilter
from dafw.plugins.models.linear_advection import LinearAdvection
from dafw.plugins.observers.grid import Grid

def peak():
    return int(re.search(r"VmHWM:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1])

for cycles in (5, 250, 500):  # after 250 cycles, 400 MB, the caches of HDF5 are full
    model = LinearAdvection(cells=200, length=200.0)
    study = dafw.Study(model=model, truth=model, observer=Grid(stride=25), filter=NoFilter(), members=1000,
                       cycles=cycles, record="all", seed=1000, pictures=False)
    dafw.run(study, Path(sys.argv[1], str(cycles)))
    print(peak())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the peak of the memory is read from /proc")
def test_the_memory_of_a_run_does_not_grow_with_its_cycles(tmp_path):
    done = subprocess.run([sys.executable, "-c", SCRIPT, str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    short, long = (int(line) * 1024 for line in done.stdout.split()[-2:])
    every_member = 250 * 1000 * 200 * 8  # bytes of what the longer run has more
    assert long - short < every_member / 5
    sizes = [(tmp_path / name / "run.nc").stat().st_size for name in ("250", "500")]
    assert sizes[1] - sizes[0] > every_member / 2  # in single precision
