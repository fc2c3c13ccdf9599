"""Real kills of real processes: ``python -m benchmarks.kills`` with three of its twenty."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_runs_that_are_killed_go_on_to_the_same_bits():
    command = [sys.executable, "-m", "benchmarks.kills", "--kills", "3", "--seed", "7"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    head, *rows, last = done.stdout.splitlines()
    assert "moment" in head and last == "3 of 3 identical"
    for row, kind, signal in zip(
        rows,
        ("before a cycle", "inside a write of HDF5", "between the variables of rows"),
        ("SIGKILL", "SIGXFSZ", "SIGKILL"),
        strict=True,
    ):
        assert kind in row and signal in row and row.endswith(": identical")
    assert "went on after [" in done.stdout
