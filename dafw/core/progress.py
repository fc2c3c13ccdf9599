"""Progress of what takes long: a bar on the terminal, and for tasks that are done once two lines in the log."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any

log = logging.getLogger(__name__)

COLUMNS, ROWS = 100, 20
"""Characters in a line, and lines, of a terminal that does not know its size."""


def progress(total: int | None, unit: str, what: str = "", done: int = 0) -> Any:
    """Return a progress bar (tqdm) on standard error; it prints nothing if that is no terminal.

    Args:
        total: how much there is to do; None if there are no parts to count, then it shows only the time.
        unit: what is counted: ``cycle``, ``wind``.
        what: what is being done, for the beginning of the line.
        done: how much was done before.
    """
    from tqdm import tqdm

    style = "{desc}: {elapsed}" if total is None else None
    # Some terminals do not know their size; tqdm would print empty lines there.
    size = {"dynamic_ncols": True} if _columns() else {"ncols": COLUMNS, "nrows": ROWS}
    given = {"desc": what or None, "unit": unit, "bar_format": style, "initial": done, **size}
    return tqdm(total=total, disable=None, file=sys.stderr, **given)


def _columns() -> int:
    """Return how wide the terminal is, in characters; 0 if there is none or it does not know."""
    try:
        return os.get_terminal_size(sys.stderr.fileno()).columns
    except OSError:
        return 0


@contextmanager
def long_task(what: str, total: int | None = None, unit: str = "") -> Iterator[Any]:
    """Show a progress bar during the block, which is given it; log before and after it, with the seconds that it took.

    The arguments are those of ``progress``.
    """
    log.info("%s", what)
    begun = perf_counter()
    with progress(total, unit, what) as bar:
        yield bar
    log.info("%s: %.1f s", what, perf_counter() - begun)
