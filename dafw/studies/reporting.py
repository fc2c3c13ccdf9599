"""What a run says on its way: its log, the progress bar, and a sentence for each cycle."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dafw.core.cycle import Cycle, Parts, State

log = logging.getLogger("dafw")


@contextmanager
def log_file(path: Path) -> Iterator[None]:
    """Write dafw's log, from INFO on, to a file while the block lasts."""
    handler = logging.FileHandler(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    previous = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(previous)
        handler.close()


def sentence(cycle: Cycle, scores: Mapping[str, float]) -> str:
    """Return what a cycle did, for the log."""
    positions = ", ".join(f"({x:.1f}, {y:.1f})" for x, y in cycle.state.vehicle.positions)
    parts = [f"ERR {scores['err']:.2f} %"] if "err" in scores else []
    parts += [f"free run {scores['err_free']:.2f} %"] if "err_free" in scores else []
    parts.append(f"{cycle.observation.values.size} readings")
    parts += [f"at {positions}"] if positions else []
    return f"t = {cycle.state.belief.ensemble.time:g} s: {', '.join(parts)}"


def postfix(state: State, scores: Mapping[str, float]) -> str:
    """Return how a run stands, for the end of its progress bar."""
    positions = " ".join(f"({x:.0f}, {y:.0f})" for x, y in state.vehicle.positions[:2])
    err = f"ERR {scores['err']:.1f} %" if "err" in scores else ""
    return f"{err} {positions}".strip()


def warn_once(warned: set[str], what: str, text: str) -> None:
    """Log a warning, and say it on standard error, the first time that it is about ``what``."""
    if what in warned:
        return
    warned.add(what)
    log.warning("%s", text)
    print(f"dafw: warning: {text}", file=sys.stderr)


def log_domain(parts: Parts) -> None:
    """Log what the model was made of."""
    for note in parts.model.notes():
        log.info("%s", note)
    log.info("state: %r", parts.model.space)
    if parts.model.domain is not None:
        log.info("domain: %s m, %d obstacles", parts.model.domain.bounds, len(parts.model.domain.obstacles))


def progress(total: int) -> Any:
    """Return the progress bar of so many cycles; silent where there is no terminal."""
    from tqdm import tqdm

    return tqdm(total=total, unit="cycle", disable=None, file=sys.stderr, dynamic_ncols=True)
