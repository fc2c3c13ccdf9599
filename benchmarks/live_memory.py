"""Peak memory of live runs on bad days: messages of 10 MB, and very many readings at one instant.

``python -m benchmarks.live_memory [--readings 1000000] [--megabytes 10]`` makes small runs, each in a process of its
own, and prints the most memory that each had, and how much more that is than with a quiet feed. The feeds are files.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from pathlib import Path
from typing import BinaryIO

from dafw import Study
from dafw.core.runs import summary_of
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.models.lorenz96 import Lorenz96
from dafw.plugins.readings.live import Live
from dafw.studies.running import run_study

CYCLES, DT = 6, 0.05


def reading(cycle: int, entry: int = 3, value: float = 2.0, sensor: str = "a") -> bytes:
    """Return a message with a reading of a cycle."""
    told = {"time": (cycle + 1) * DT, "entry": entry, "value": value, "sd": 1.0, "sensor": sensor}
    return json.dumps(told).encode() + b"\n"


def write(path: Path, more: Callable[[BinaryIO], None]) -> None:
    """Write a feed with a reading a cycle; ``more`` writes what comes in the third."""
    with path.open("wb") as stream:
        for cycle in range(CYCLES):
            stream.write(reading(cycle))
            if cycle == 2:
                more(stream)
            stream.write(json.dumps({"until": (cycle + 1) * DT}).encode() + b"\n")


def peak(feed: Path, folder: Path) -> tuple[float, float, dict[str, int]]:
    """Run in a process of its own; return its most memory (MB), its seconds of the processor, and what it left out."""
    if not (process := os.fork()):
        status = 1
        try:
            with redirect_stderr(io.StringIO()):
                study = Study(model=Lorenz96(dt=DT), filter=ETKF(), readings=Live(source=str(feed)), members=8)
                study.cycles = CYCLES
                run_study(study, folder)
            status = 0
        finally:
            os._exit(status)
    _, status, used = os.wait4(process, 0)
    if status != 0:
        raise SystemExit(f"live_memory: the run in {folder} ended with {os.waitstatus_to_exitcode(status)}")
    return used.ru_maxrss / 1e3, used.ru_utime + used.ru_stime, summary_of(folder)["readings_left_out"]


def main(words: Sequence[str] | None = None) -> int:
    """Run, print; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live_memory", description="Measure peak memory.")
    parser.add_argument("--readings", type=int, default=1_000_000, help="readings at one instant")
    parser.add_argument("--megabytes", type=int, default=10, help="size of a message that is too long")
    asked = parser.parse_args(words)

    def flood(stream: BinaryIO) -> None:
        for number in range(asked.readings):
            stream.write(reading(2, number % 40, number / asked.readings, f"s{number % 10}"))

    def long(stream: BinaryIO) -> None:
        for _ in range(10):
            stream.write(b'{"time": 0.1, "note": "' + b"x" * (asked.megabytes * 1_000_000) + b'"}\n')

    kinds: dict[str, Callable[[BinaryIO], None]] = {
        "a quiet feed": lambda stream: None,
        f"ten messages of {asked.megabytes} MB": long,
        f"{asked.readings} readings at one instant": flood,
    }
    row = "{:38} {:>9} {:>9} {:>12}  {}"
    print(row.format("", "peak, MB", "more, MB", "processor, s", "left out"))
    quiet = 0.0
    with tempfile.TemporaryDirectory(prefix="dafw-memory-") as name:
        for number, (kind, more) in enumerate(kinds.items()):
            feed = Path(name, f"{number}.jsonl")
            write(feed, more)
            most, seconds, left_out = peak(feed, Path(name, str(number)))
            quiet = quiet or most
            print(row.format(kind, f"{most:.0f}", f"{most - quiet:.0f}", f"{seconds:.1f}", left_out or "none"))
            sys.stdout.flush()
            feed.unlink()
    return 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
