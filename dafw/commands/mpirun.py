"""``mpirun -n N dafw run``: N processes share the domain of one run; only rank 0 writes files and prints.

The tasks of SLURM's srun work in the same way. Every rank runs the same cycles with the same random numbers. Every
command loads this module, so it imports nothing heavy.
"""

from __future__ import annotations

import math
import os
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

PATIENCE = 10.0
"""Seconds that a failed rank waits for the other ranks to end; then it ends them."""
FAREWELL = 1.0
"""Seconds to wait before aborting, so that mpirun can pass on the last message; otherwise it may get lost."""
LAUNCHERS = (
    ("mpirun", "PMI_RANK", "PMI_SIZE"),
    ("mpirun", "OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"),
    ("srun", "SLURM_PROCID", "SLURM_STEP_NUM_TASKS"),
)
CGROUP = Path("/proc/self/cgroup")
RANKS = ("PMI_RANK", "PMIX_RANK")
"""Variables of launchers that give a rank without a size. A rank above 0 is one of several; rank 0 may be alone."""


class Launch(NamedTuple):
    """The launcher of this process, its rank and the number of processes; size 0: several, of unknown number."""

    launcher: str
    rank: int
    size: int


ALONE = Launch("", 0, 1)


def launched() -> Launch:
    """Return how this process was started, from the launcher's environment variables; rank 0 of 1 without any."""
    for launcher, rank, size in LAUNCHERS:
        if _number(rank) is not None and (several := _number(size)) is not None:
            if launcher == "srun" and several > 1 and not _is_task():
                return ALONE
            return Launch(launcher, int(os.environ[rank]), several)
    found = max((_number(name) or 0 for name in RANKS), default=0)
    return Launch("mpirun", found, 0) if found else ALONE


def _number(name: str) -> int | None:
    value = os.environ.get(name, "")
    return int(value) if value.isdigit() else None


def _is_task() -> bool:
    """Return whether srun started this process of a SLURM job.

    The variables alone do not tell. A shell of ``srun --pty`` also has variables of several tasks, but it has a
    terminal. A batch script may have inherited the variables of the shell that submitted it.
    """
    try:
        os.close(os.open("/dev/tty", os.O_RDONLY | os.O_NOCTTY))
        return False
    except OSError:
        pass
    try:
        return "/step_batch" not in CGROUP.read_text()
    except OSError:
        return True


def shares(words: Sequence[str]) -> bool:
    """Return whether a command started in several processes is to be run by them together, or else refused.

    srun may start any command once on every node; mpirun is only for commands that processes run together.
    """
    launch = launched()
    return launch.size != 1 and (words[0] == "run" or launch.launcher != "srun")


def run_on_all_ranks(command: Callable[[Any], tuple[int, str]], words: Sequence[str]) -> int:
    """Call ``command(communicator)`` on every rank and return the exit status; rank 0 prints what went wrong.

    ``command`` returns an exit status and a message; ``words`` are those of the command line, the first its name.
    """
    launcher, rank, size = launched()
    if size == 0:
        expected = f"expected the mpirun of dafw's own environment, or none of {', '.join(RANKS)} for a run alone"
        return _say(2, f"rank {rank} of a launcher that does not give the number of processes: {expected}", rank - 1)
    if words[0] != "run":
        return _say(2, f"'dafw {words[0]}' works in one process: mpirun is for 'dafw run'", rank)
    import logging  # here: every command loads this module, and these two would be 7 % of `dafw plugins`
    import traceback

    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # about another mpirun; reported below
        from mpi4py import MPI

    world = MPI.COMM_WORLD
    if world.size != size:
        vendor = " ".join(map(str, MPI.get_vendor()[:1]))
        expected = f"expected the mpirun of {vendor}"
        if launcher == "srun":
            expected += ", or for a run in each of them SLURM_STEP_NUM_TASKS unset"
        return _say(2, f"{launcher} started {size} processes, which see {world.size}: {expected}", rank)
    endings = world.Dup()
    if rank > 0:
        logging.getLogger("dafw").addHandler(logging.NullHandler())
    if any(other != list(words) for other in endings.allgather(list(words))):
        return _say(2, "mpirun expects the same words on all ranks", rank)
    try:
        status, message = command(world)
    except SystemExit as end:  # Hydra's
        status, message = int(end.code or 0), ""
    except Exception:
        status, message = 1, traceback.format_exc()
    if not _all_ended(endings, PATIENCE if status else math.inf):
        if message:
            print(f"dafw: rank {rank}: {message}", file=sys.stderr, flush=True)
        time.sleep(FAREWELL)
        world.Abort(status)
    ends = endings.allgather((status, message))
    status, message = next((end for end in ends if end[0]), (0, ""))
    return _say(status, message, rank)


def _all_ended(endings: Any, patience: float) -> bool:
    """Return whether all ranks end within ``patience`` seconds."""
    arrived, deadline = endings.Ibarrier(), time.monotonic() + patience
    while not arrived.Test():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


def _say(status: int, message: str, rank: int) -> int:
    if message and rank == 0:
        print(f"dafw: {message}", file=sys.stderr)
    return status
