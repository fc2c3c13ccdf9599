"""Feeds broken files and messages to all readers for a bounded time: no crash, no hang, no traceback.

``python -m benchmarks.fuzz [--seconds 60] [--seed 0] [--only csv feed]`` tries case after case, in a process of its own
that may die, until that has used so many seconds of the processor. Every case must be read, or be refused in one line.
The command prints how many were, by reader, and each finding once with the words that try it again
(``--only TARGET --case NUMBER``); its exit status is 1 if there was one.

Each input is a file before it is read. Of a process that died or hung, ``--keep FOLDER`` keeps the last input, where it
was (``trace.txt``), and the words that try again all cases of that process (``again.txt``).
"""

from __future__ import annotations

import argparse
import faulthandler
import mmap
import os
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

import netCDF4  # noqa: F401 - first: see dafw/core/run_file.py
import xarray  # noqa: F401 - loaded once, here, and not by every process that died

from benchmarks.fuzzing.targets import TARGETS

HANGS = 20.0
"""Seconds of the processor that no case may take."""
MEMORY = 6 << 30
"""Bytes of address space that the process may have: a case that asks for more is a finding."""
TRACE = "trace.txt"
"""Where a process that dies says where it was."""
STATE = struct.Struct("<qd")
"""What the process tells while it works: the number of the case, and the seconds of the processor used so far."""


@dataclass
class Tally:
    """How the cases ended, by reader and by end; and what was found, with the first case that shows it."""

    ends: Counter[tuple[str, str]] = field(default_factory=Counter)
    findings: dict[str, tuple[str, int]] = field(default_factory=dict)

    def find(self, text: str, target: str, number: int) -> None:
        """Note a finding; the first of its kind is told on standard error at once."""
        if text not in self.findings:
            self.findings[text] = (target, number)
            print(f"{text} (case {number})", file=sys.stderr, flush=True)


def tried(target: str, number: int, seed: int, place: Path | None = None) -> str:
    """Try a case; return how it ended, a finding with a word and a colon before it.

    Its files are in the folder "case" of ``place``, and stay there until the next case; without one they are removed.
    """
    if place is None:
        with tempfile.TemporaryDirectory(prefix="dafw-fuzz-") as name:
            return tried(target, number, seed, Path(name))
    rng, name = Random(f"{seed} {target} {number}"), str(place)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        folder = place / "case"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        try:
            return TARGETS[target](folder, rng)
        except (Exception, SystemExit) as error:
            frames = traceback.extract_tb(error.__traceback__)
            own = [one for one in frames if "/dafw/" in one.filename or "/benchmarks/" in one.filename]
            place = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else "?"
            return f"FOUND: {type(error).__name__} at {place}: {' '.join(str(error).replace(name, '').split())[:150]}"


def _worker(
    targets: Sequence[str], first: int, last: int | None, seed: int, shared: mmap.mmap, pipe: int, place: Path
) -> None:
    """Try cases from ``first`` on in a folder, and write a line for each into a pipe."""
    faulthandler.enable((place / TRACE).open("w"))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # libraries written in C complain there
    number = first
    with os.fdopen(pipe, "w") as stream:
        while last is None or number < last:
            shared[: STATE.size] = STATE.pack(number, time.process_time())
            end = tried(targets[number % len(targets)], number, seed, place)
            stream.write(f"{number}\t{end}\n")
            stream.flush()
            number += 1


def _read(stream: int, tally: Tally, targets: Sequence[str], rest: bytes = b"") -> bytes:
    """Count what has come through the pipe; return the part of a line that is not complete."""
    while True:
        try:
            data = os.read(stream, 1 << 16)
        except BlockingIOError:
            return rest
        if not data:
            return rest
        *lines, rest = (rest + data).split(b"\n")
        for line in lines:
            number, _, end = line.decode(errors="replace").partition("\t")
            target = targets[int(number) % len(targets)]
            if end.startswith("FOUND"):
                tally.find(f"{target}: {end}", target, int(number))
                end = "found"
            tally.ends[target, end] += 1


def fuzz(
    targets: Sequence[str],
    seconds: float,
    seed: int,
    first: int = 0,
    last: int | None = None,
    keep: Path | None = None,
) -> Tally:
    """Try cases until their processes have used so many seconds of the processor, or up to case ``last``.

    ``keep`` is a folder for the last inputs of processes that died or hung.
    """
    with tempfile.TemporaryDirectory(prefix="dafw-fuzz-") as name:
        return _fuzz(targets, seconds, seed, first, last, keep, Path(name))


def _fuzz(
    targets: Sequence[str], seconds: float, seed: int, first: int, last: int | None, keep: Path | None, place: Path
) -> Tally:
    tally, used, shared = Tally(), 0.0, mmap.mmap(-1, STATE.size)
    while used < seconds and (last is None or first < last):
        reading, writing = os.pipe()
        shared[: STATE.size] = STATE.pack(first, 0.0)
        if not (process := os.fork()):
            try:
                _worker(targets, first, last, seed, shared, writing, place)
            finally:
                os._exit(0)
        os.close(writing)
        os.set_blocking(reading, False)
        rest, ended, before, changed = b"", None, (-1, 0.0), time.monotonic()
        while ended is None:
            time.sleep(0.05)
            rest = _read(reading, tally, targets, rest)
            number, spent = STATE.unpack(shared[: STATE.size])
            if (number, spent) != before:
                before, changed = (number, spent), time.monotonic()
            hangs = _spent(process) - spent > HANGS or time.monotonic() - changed > 6 * HANGS
            if hangs:  # it says where it is
                os.kill(process, signal.SIGABRT)
                time.sleep(0.2)
            if hangs or used + spent > seconds:
                os.kill(process, signal.SIGKILL)
            found, status = os.waitpid(process, 0 if hangs or used + spent > seconds else os.WNOHANG)
            if found:
                rest = _read(reading, tally, targets, rest)
                number, spent = STATE.unpack(shared[: STATE.size])
                ended = status
                if hangs or (os.WIFSIGNALED(status) and used + spent <= seconds):
                    how = "does not end" if hangs else f"is ended by {signal.Signals(os.WTERMSIG(status)).name}"
                    target = targets[number % len(targets)]
                    tally.find(f"{target}: {how}", target, number)
                    tally.ends[target, "found"] += 1
                    if keep is not None:
                        again = ["--seed", seed, "--only", *targets, "--first", first, "--cases", number + 1]
                        (place / "again.txt").write_text(" ".join(map(str, ["python -m benchmarks.fuzz", *again])))
                        shutil.copytree(place, keep / f"{target}-{seed}-{number}", dirs_exist_ok=True)
        os.close(reading)
        used, first = used + spent, number + 1
    return tally


def _spent(process: int) -> float:
    """Return the seconds of the processor that a process has used."""
    try:
        cells = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(cells[11]) + int(cells[12])) / os.sysconf("SC_CLK_TCK")


def main(words: Sequence[str] | None = None) -> int:
    """Try cases, print how they ended; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fuzz", description="Feed broken input to all readers.")
    parser.add_argument("--seconds", type=float, default=60.0, help="seconds of the processor")
    parser.add_argument("--first", type=int, default=0, help="the case to begin with")
    parser.add_argument("--cases", type=int, help="up to this case, at most")
    parser.add_argument("--seed", type=int, default=0, help="seed of the cases")
    parser.add_argument("--only", nargs="+", choices=list(TARGETS), default=list(TARGETS), help="which readers")
    parser.add_argument("--case", type=int, help="the number of one case of one reader, which is tried here")
    parser.add_argument("--keep", type=Path, help="folder for the last inputs of processes that died or hung")
    asked = parser.parse_args(words)
    if asked.case is not None:
        if len(asked.only) != 1:
            parser.error("--case goes with one name after --only")
        print(tried(asked.only[0], asked.case, asked.seed))
        return 0
    tally = fuzz(asked.only, asked.seconds, asked.seed, asked.first, asked.cases, asked.keep)
    for target in asked.only:
        ends = {end: count for (one, end), count in sorted(tally.ends.items()) if one == target}
        told = ", ".join(f"{count} {end}" for end, count in ends.items())
        print(f"{target:12} {sum(ends.values()):6} cases: {told}")
    for text, (target, number) in tally.findings.items():
        print(f"{text}\n    python -m benchmarks.fuzz --seed {asked.seed} --only {target} --case {number}")
    print(f"{len(tally.findings)} findings")
    return 1 if tally.findings else 0


if __name__ == "__main__":
    sys.exit(main())
