"""Progress of what takes long: a bar on the terminal, and for tasks that are done once two lines in the log."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any

log = logging.getLogger(__name__)


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
    given = {"desc": what or None, "unit": unit, "bar_format": style, "initial": done}
    return tqdm(total=total, disable=None, file=sys.stderr, dynamic_ncols=True, **given)


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
