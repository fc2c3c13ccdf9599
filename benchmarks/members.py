"""The memory of a run that records its whole ensemble: 10,000 numbers, 100 members, 1,000 cycles.

``linear_advection`` is used, because it costs nothing. ``run.nc`` takes 4 GB (single precision), and as much again
while the run goes on, for the journal from which ``dafw resume`` makes the file anew. Both are removed.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks import Measurement, benchmark
from dafw.core.errors import ComputationError

SIZE = ("model.cells=10000", "model.length=10000", "observer.stride=1000", "members=100", "cycles=1000")
SMALL = ("model.cells=100", "model.length=100", "observer.stride=10", "members=10", "cycles=20")


@benchmark("members.peak_mb")
def peak_mb(short: bool) -> Measurement:
    """Largest memory of a run of 10,000 numbers, 100 members and 1,000 cycles that records every member, in MB."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["experiment=linear_advection", "filter=etkf", "record.members=all", "pictures=false", "seed=1000"]
        words += [*(SMALL if short else SIZE), f"hydra.run.dir={folder}/run"]
        process = subprocess.Popen([sys.executable, "-m", "dafw", "run", *words], stdout=subprocess.DEVNULL)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise ComputationError(f"dafw run {' '.join(words)} failed")
        written = sum(path.stat().st_size for path in Path(folder).rglob("run.nc"))
    detail = {"run.nc_gb": round(written / 1e9, 2), "processor_seconds": round(used.ru_utime + used.ru_stime)}
    return Measurement(used.ru_maxrss / 1024, "MB", 1000, detail)
