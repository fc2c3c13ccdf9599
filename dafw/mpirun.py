"""``mpirun -n N dafw run``: N processes share the domain of one run; rank 0 alone writes and speaks.

Every rank runs the same cycles with the same random numbers. Loaded by every command, so nothing heavy here.
"""

from __future__ import annotations

import logging
import math
import os
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from typing import Any

PATIENCE = 10.0
"""Seconds for which a rank that failed waits for the others to come to an end, too; then it ends them."""
FAREWELL = 1.0
"""Seconds that mpirun has to pass on a last message; ended at once, it may lose it."""
LAUNCHERS = (("PMI_RANK", "PMI_SIZE"), ("OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"))


def launched() -> tuple[int, int]:
    """Return this process's rank and how many mpirun started, by what it leaves in the environment; (0, 1) without."""
    for rank, size in LAUNCHERS:
        if os.environ.get(rank, "").isdigit() and os.environ.get(size, "").isdigit():
            return int(os.environ[rank]), int(os.environ[size])
    return 0, 1


def together(command: Callable[[Any], tuple[int, str]], words: Sequence[str]) -> int:
    """Have every rank call ``command(communicator)`` and return the exit status; rank 0 says what went wrong.

    ``command`` returns an exit status and a message; ``words`` are those of the command line, the first its name.
    """
    rank, size = launched()
    if words[0] != "run":
        return _say(2, f"'dafw {words[0]}' works in one process: mpirun is for 'dafw run'", rank)
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # of another mpirun: said below
        from mpi4py import MPI

    world = MPI.COMM_WORLD
    if world.size != size:
        vendor = " ".join(map(str, MPI.get_vendor()[:1]))
        return _say(
            2, f"mpirun started {size} processes, which see {world.size}: expected the mpirun of {vendor}", rank
        )
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
    """Say whether all ranks come to an end within so many seconds."""
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
