"""Kills runs at many moments, some inside a write or on a full disk, lets them go on, and compares to the last bit.

``python -m benchmarks.kills [--kills N] [--seed S]`` prints a log with a line for each kill, and ends with status 1 if
a run that went on differs from one that was never interrupted. It needs no fast machine: all moments but those "by the
clock" are counted in events, such as the seventh write of rows. The runs are processes of their own, ended by SIGKILL.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np

import dafw
from dafw.core.checkpoints import checkpoint_file, journal
from dafw.core.checkpoints.checkpoint_file import FOLDER, checkpoints
from dafw.core.composition import compose, study_part
from dafw.core.errors import DafwError
from dafw.core.experiment import study_from
from dafw.core.record import Record
from dafw.core.run_file import RunFile
from dafw.core.runs import summary_of
from dafw.studies import running
from dafw.studies.replaying import difference_of

CYCLES, EVERY = 48, 4
WORDS = [
    *(
        "experiment=lorenz96",
        "filter=enks",
        "filter.window=3",
        "members=20",
        f"cycles={CYCLES}",
        "pictures=false",
        "record.members=all",
    ),
    *("forecast.every=0.5", "forecast.horizon=0.2", "forecast.lead_times=[0,0.1]", f"checkpoint.cycles={EVERY}"),
]
"""A smoother that rewrites rows, with forecasts: everything that a checkpoint must hold."""
SMALL_DISK = 1_300_000
"""Bytes of the disk that becomes full."""


@cache
def composed() -> dict[str, Any]:
    """Return the configuration of the study; called here once, so that the copies of this process need not do it."""
    return study_part(compose(WORDS))


@dataclass(frozen=True)
class Ended:
    """How a run that was started ended: its exit status or signal, and what it said."""

    status: int
    said: str

    @property
    def how(self) -> str:
        """The end in words."""
        if os.WIFSIGNALED(self.status):
            return signal.Signals(os.WTERMSIG(self.status)).name
        code = os.waitstatus_to_exitcode(self.status)
        return "complete" if code == 0 else f"status {code}"


def run(folder: Path, prepare: Callable[[], None] | None = None, seconds: float | None = None) -> Ended:
    """Run the study into a folder, or go on with it, in a process of its own; kill it after so many seconds."""
    return forked(lambda: running.run_study(study_from(composed()), folder, resume=True), prepare, seconds)


def forked(work: Callable[[], Any], prepare: Callable[[], None] | None, seconds: float | None) -> Ended:
    """Do something in a process of its own, which is prepared for its kill, or killed after so many seconds."""
    reading, writing = os.pipe()
    if not (process := os.fork()):
        os.close(reading)
        os.dup2(writing, 2)
        status = 1
        try:
            if prepare is not None:
                prepare()
            work()
            status = 0
        except DafwError as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        finally:
            os._exit(status)
    os.close(writing)
    if seconds is not None:
        time.sleep(seconds)
        os.kill(process, signal.SIGKILL)
    with os.fdopen(reading) as stream:
        said = stream.read()
    return Ended(os.waitpid(process, 0)[1], said)


def started(work: Callable[[], Any]) -> int:
    """Do something in a process of its own; return its number."""
    if not (process := os.fork()):
        try:
            work()
        finally:
            os._exit(0)
    return process


def kill() -> None:
    """End this process as a power cut would."""
    os.kill(os.getpid(), signal.SIGKILL)


def at_call(owner: Any, name: str, number: int, instead: Callable[..., None] | None = None) -> Callable[[], None]:
    """Return what makes the ``number``-th call of a function the last thing that a process does.

    ``instead`` is called with the same arguments first, to do a part of it.
    """

    def prepare() -> None:
        original, calls = getattr(owner, name), [0]

        def counted(*arguments: Any, **more: Any) -> Any:
            calls[0] += 1
            if calls[0] == number:
                if instead is not None:
                    instead(*arguments, **more)
                kill()
            return original(*arguments, **more)

        setattr(owner, name, counted)

    return prepare


def half_the_rows(file: Any, count: int, blocks: Any) -> None:
    """Write half of the variables of some rows, and send them to the disk."""
    write = RunFile._write_blocks
    while hasattr(write, "__wrapped__"):
        write = write.__wrapped__
    first = file._written
    for name, block in list(blocks.items())[: len(blocks) // 2]:
        if block.size:
            file._file.variables[name][(slice(first, first + count), *map(slice, block.shape[1:]))] = block
    file._file.sync()


def half_an_entry(own: Any, told: Any, arrays: Any = None) -> None:
    """Append a part of an entry to a journal, and send it to the disk."""
    own._stream.write(b"\x40\x00\x00\x00\x10")
    own._stream.flush()


def half_an_array(stream: Any, array: Any, **more: Any) -> None:
    """Write a part of an array into a checkpoint."""
    stream.write(np.asarray(array).tobytes()[: array.nbytes // 2])


def limited(size: int, kills: bool) -> Callable[[], None]:
    """Return what makes a process end, or a write fail, where a file would grow beyond ``size`` bytes."""

    def prepare() -> None:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        signal.signal(signal.SIGXFSZ, signal.SIG_DFL if kills else signal.SIG_IGN)

    return prepare


@contextmanager
def small_disk(place: Path) -> Iterator[bool]:
    """Mount a small file system in a folder; yield whether that was possible."""
    place.mkdir()
    mounted = mount("-t", "tmpfs", "-o", f"size={SMALL_DISK}", "tmpfs", str(place))
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", str(place)], check=True)


def mount(*words: str) -> bool:
    """Mount something; return whether that was possible."""
    try:
        return subprocess.run(["mount", *words], check=False, capture_output=True).returncode == 0
    except OSError:
        return False


def kinds(size: int) -> dict[str, Callable[[random.Random], tuple[str, Callable[[], None]]]]:
    """Return the kinds of kills: each draws its moment, and what prepares a process for it.

    ``size`` is that of the run's file in bytes.
    """
    rows = CYCLES // EVERY

    def at(owner: Any, name: str, most: int, unit: str, instead: Any = None) -> Any:
        def draw(rng: random.Random) -> tuple[str, Callable[[], None]]:
            number = rng.randint(1, most)
            return f"{unit} {number}", at_call(owner, name, number, instead)

        return draw

    def inside(rng: random.Random) -> tuple[str, Callable[[], None]]:
        place = size - rng.randint(1, size // 5)  # netCDF allots most of a short file at once
        return f"byte {place} of run.nc", limited(place, kills=True)

    return {
        "before a cycle": at(running, "advance", CYCLES, "cycle"),
        "inside a write of HDF5": inside,
        "between the variables of rows": at(RunFile, "_write_blocks", rows, "write", half_the_rows),
        "inside a checkpoint": at(np.lib.format, "write_array", 12 * rows, "array", half_an_array),
        "between a checkpoint and its name": at(os, "fsync", 3 * rows, "fsync"),
        "inside a journal": at(journal.Journal, "add", 55, "entry", half_an_entry),
        "before old checkpoints go": at(checkpoint_file, "checkpoints", rows, "checkpoint"),
    }


def left(folder: Path) -> str:
    """Return what a killed run left: the cycles of its checkpoints, and whether its file opens."""
    found = [str(int(path.stem.removeprefix("state-"))) for path in checkpoints(folder / FOLDER)]
    opens = "absent"
    if (folder / "run.nc").exists():
        try:
            netCDF4.Dataset(folder / "run.nc").close()
            opens = "opens"
        except OSError:
            opens = "damaged"
    return f"{','.join(found) or 'none'}; run.nc {opens}"


def difference(one: Path, other: Path) -> str:
    """Return the first difference of two runs, '' if there is none."""
    if summary_of(other).get("status") != "complete":
        return f"it is {summary_of(other).get('status', 'missing')}"
    with dafw.open_run(one) as before, dafw.open_run(other) as now:
        if found := difference_of(before, now, "time"):
            return found
    with dafw.open_forecasts(one) as before, dafw.open_forecasts(other) as now:
        return difference_of(before, now, "issue")


def full_disk(place: Path, reference: Path) -> tuple[str, str, str, Path]:
    """Run on a disk that becomes full; make it larger, and go on. Return the moment, the end, what is left, the run."""
    folder = place / "run"
    with small_disk(place) as mounted:
        if mounted:
            moment, ended = f"tmpfs of {SMALL_DISK // 1000} kB", run(folder)
            state = left(folder)
            mount("-o", "remount,size=64m", str(place))
        else:
            size = (reference / "run.nc").stat().st_size // 2
            moment, ended = f"no file above {size} bytes", run(folder, limited(size, kills=False))
            state = left(folder)
        run(folder)
        kept = place.with_name(f"{place.name}-kept")
        folder.rename(kept) if not mounted else subprocess.run(["cp", "-a", folder, kept], check=True)
    return moment, ended.how, state, kept


def main(words: Sequence[str] | None = None) -> int:
    """Kill, go on, compare, print the log; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kills", description="Kill runs and let them go on.")
    parser.add_argument("--kills", type=int, default=20, help="how many runs are killed")
    parser.add_argument("--seed", type=int, default=0, help="seed of the moments")
    asked = parser.parse_args(words)
    rng, identical = random.Random(asked.seed), 0
    row = "{:>3}  {:34} {:26} {:11} {:30} {}"
    with tempfile.TemporaryDirectory(prefix="dafw-kills-") as name:
        place = Path(name)
        reference = place / "reference"
        composed()
        begun = time.monotonic()
        ended = run(reference)
        whole = time.monotonic() - begun
        if ended.how != "complete":
            print(f"the run that is not killed ends with {ended.how}: {ended.said}", file=sys.stderr)
            return 1
        chosen = kinds((reference / "run.nc").stat().st_size)
        listed = [*chosen, "by the clock", "twice, while it goes on", "on a full disk"]
        print(row.format("", "killed", "moment", "ended", "checkpoints", "afterwards"))
        for number in range(asked.kills):
            kind, folder = listed[number % len(listed)], place / f"run-{number}"
            if kind == "on a full disk":
                moment, how, state, folder = full_disk(place / f"disk-{number}", reference)
            else:
                if kind == "by the clock":
                    seconds = rng.uniform(0.2, 0.9) * whole
                    moment, ended = f"{seconds:.3f} s", run(folder, seconds=seconds)
                elif kind == "twice, while it goes on":
                    moment, first = chosen["before a cycle"](rng)
                    run(folder, first)
                    ended = run(folder, at_call(Record, "_repeat", 1))
                else:
                    moment, prepare = chosen[kind](rng)
                    ended = run(folder, prepare)
                how, state = ended.how, left(folder)
                last = run(folder)
                if last.how != "complete":
                    state += f" ({last.said.strip()})"
            found = difference(reference, folder)
            after = summary_of(folder).get("resumed_after") or "the start"
            identical += not found
            result = f"went on after {after}: {found or 'identical'}"
            print(row.format(number + 1, kind, moment, how, state, result), flush=True)
    print(f"{identical} of {asked.kills} identical")
    return 0 if identical == asked.kills else 1


if __name__ == "__main__":
    sys.exit(main())
