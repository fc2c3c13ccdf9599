"""Broken input for all readers, a few fixed cases of each: ``python -m benchmarks.fuzz`` tries more."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.fuzzing.targets import TARGETS

ROOT = Path(__file__).parent.parent


def command(*words):
    words = [sys.executable, "-m", "benchmarks.fuzz", *words]
    return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)


def test_no_broken_input_does_more_than_be_refused():
    done = command("--cases", str(40 * len(TARGETS)), "--seconds", "1000", "--seed", "7")
    assert done.returncode == 0, done.stdout + done.stderr
    *rows, last = done.stdout.splitlines()
    assert last == "0 findings"
    assert [row.split()[:2] for row in rows] == [[target, "40"] for target in TARGETS]
    assert sum("refused" in row for row in rows) >= 5 and sum(" read" in row for row in rows) >= 3


BROKEN = """
import os, sys, time
from benchmarks import fuzz
from benchmarks.fuzzing import targets

def wrong(folder, rng):
    (folder / "a.csv").write_text("the input")
    kind = rng.choice(("raises", "dies", "hangs", "says two lines"))
    if kind == "raises":
        {}["a key"]
    if kind == "dies":
        os.kill(os.getpid(), 11)
    if kind == "says two lines":
        return targets.refused(fuzz_error("one\\ntwo"))
    while True:
        pass

from dafw.core.errors import ReadingsError as fuzz_error
targets.TARGETS["csv"] = wrong
fuzz.HANGS = 0.3
sys.exit(fuzz.main(["--only", "csv", "--cases", "20", "--keep", sys.argv[1]]))
"""


def test_what_raises_dies_or_hangs_is_found_and_the_last_input_of_what_died_is_kept(tmp_path):
    words = [sys.executable, "-c", BROKEN, tmp_path]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    for word in ("KeyError at", "is ended by SIGSEGV", "does not end", "AssertionError at"):
        assert done.stdout.count(f"csv: FOUND: {word}") + done.stdout.count(f"csv: {word}") == 1, done.stdout
    assert done.stdout.splitlines()[-1] == "4 findings"
    kept = sorted(tmp_path.iterdir())
    assert kept and all((one / "case" / "a.csv").read_text() == "the input" for one in kept)
    traces = [(one / "trace.txt").read_text() for one in kept]
    assert all("in wrong" in trace for trace in traces) and any("Segmentation fault" in trace for trace in traces)
    assert "--only csv --first " in (kept[0] / "again.txt").read_text()


@pytest.mark.parametrize("target", TARGETS)
def test_a_case_is_the_same_each_time(target):
    from benchmarks.fuzz import tried

    assert tried(target, 3, 7) == tried(target, 3, 7)
