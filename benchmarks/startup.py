"""Start-up: how long ``dafw --help`` and ``dafw plugins`` take, as a multiple of importing NumPy and Hydra."""

from __future__ import annotations

import statistics
import subprocess
import sys
from time import perf_counter

from benchmarks import Measurement, benchmark

BASE = (sys.executable, "-c", "import numpy, hydra")
LIMIT = 1.3


def _seconds(command: tuple[str, ...]) -> float:
    begun = perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    return perf_counter() - begun


def _against_base(short: bool, *words: str) -> Measurement:
    """Time ``dafw WORDS`` and the imports alternately; the value is the median of the ratios."""
    command = (sys.executable, "-m", "dafw", *words)
    for warming in (BASE, command):
        _seconds(warming)
    pairs = [(_seconds(BASE), _seconds(command)) for _ in range(1 if short else 15)]
    ratio = statistics.median(ours / base for base, ours in pairs)
    detail = {"seconds": [ours for _, ours in pairs], "base_seconds": [base for base, _ in pairs]}
    return Measurement(ratio, "import of numpy and hydra", LIMIT, detail)


@benchmark("startup.help_over_numpy_hydra")
def help_over_numpy_hydra(short: bool) -> Measurement:
    """`dafw --help` takes at most 1.3 times as long as `python -c "import numpy, hydra"`."""
    return _against_base(short, "--help")


@benchmark("startup.plugins_over_numpy_hydra")
def plugins_over_numpy_hydra(short: bool) -> Measurement:
    """`dafw plugins` takes at most 1.3 times as long as `python -c "import numpy, hydra"`."""
    return _against_base(short, "plugins")
