"""Ends runs in the middle, in this process, as a kill would: nothing is closed, no end is noted.

``benchmarks/kills.py`` does the same to processes of their own, with SIGKILL.
"""

import gc
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from dafw.studies import running


class Killed(BaseException):
    """No handler of a run catches it."""


def killed(monkeypatch, call, cycle):
    """Call ``call()``, which runs a study and is ended at the beginning of its ``cycle``-th cycle, counted from 1."""
    advance, calls = running.advance, []

    def counted(parts, state, *more):
        calls.append(state)
        if len(calls) == cycle:
            raise Killed
        return advance(parts, state, *more)

    monkeypatch.setattr(running, "advance", counted)
    ended = False
    with warnings.catch_warnings(action="ignore", category=ResourceWarning):
        try:
            call()
        except Killed:
            ended = True
        gc.collect()  # what was left open is closed now, and not while another run writes
    monkeypatch.setattr(running, "advance", advance)
    if not ended:
        pytest.fail(f"the run has fewer than {cycle} cycles")


def log_of_kills(benchmark, kills):
    """Run ``python -m BENCHMARK``, which kills runs and lets them go on; return the head and the rows of its log."""
    command = [sys.executable, "-m", benchmark, "--kills", str(kills), "--seed", "7"]
    root = Path(__file__).parent.parent
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    head, *rows, last = done.stdout.splitlines()
    assert len(rows) == kills and last == f"{kills} of {kills} identical"
    return head, rows
