"""Messages of a run: its log, the progress bar, and a sentence for each cycle."""

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dafw.core.cycle import Cycle, Parts, State
from dafw.core.space import Kind
from dafw.core.study import Study

log = logging.getLogger("dafw")


@contextmanager
def log_file(path: Path) -> Iterator[None]:
    """Write dafw's log, level INFO and above, to a file during the block."""
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
    """Return a sentence about a cycle, for the log."""
    positions = ", ".join(f"({x:.1f}, {y:.1f})" for x, y in cycle.state.vehicle.positions)
    parts = [f"ERR {scores['err']:.2f} %"] if "err" in scores else []
    parts += [f"free run {scores['err_free']:.2f} %"] if "err_free" in scores else []
    if "err" not in scores and math.isfinite(scores["innovation_rms"]):
        parts.append(f"innovations {scores['innovation_rms']:.2f}")
    parts.append(said_of_readings(cycle.readings.counts))
    parts += [f"at {positions}"] if positions else []
    return f"t = {cycle.state.belief.ensemble.time:g} s: {', '.join(parts)}"


def postfix(state: State, scores: Mapping[str, float]) -> str:
    """Return the current scores of a run, for the end of its progress bar."""
    positions = " ".join(f"({x:.0f}, {y:.0f})" for x, y in state.vehicle.positions[:2])
    stands = f"ERR {scores['err']:.1f} %" if "err" in scores else ""
    if not stands and math.isfinite(scores["innovation_rms"]):
        stands = f"innovations {scores['innovation_rms']:.1f}"
    return f"{stands} {positions}".strip()


def said_of_readings(counts: Mapping[str, int]) -> str:
    """Return the number of readings and their use: ``5 readings (3 on time, 1 late, 1 dropped)``.

    ``counts`` are keyed by use, as in ``dafw.core.late.Sorted``. If all were on time, only their number is given.
    """
    total = sum(counts.values())
    late = counts.get("late_in_window", 0) + counts.get("late_used_now", 0)
    dropped = counts.get("late_dropped", 0) + counts.get("before_start", 0)
    text = f"{total or 'no'} reading{'' if total == 1 else 's'}"
    if not late and not dropped:
        return text
    uses = {"on time": counts.get("on_time", 0), "late": late, "dropped": dropped}
    return f"{text} ({', '.join(f'{number} {use}' for use, number in uses.items() if number)})"


def closing_line(study: Study, summary: Mapping[str, Any]) -> str:
    """Return the result of the run in one sentence.

    With a truth: ERR of the belief and of the free run, and that of an all-zero map if the scored variable cannot be
    negative. Without a truth: the statistics of the innovations.
    """
    scored = study.model.space.variables[0]
    if study.truth is not None:
        parts = [f"the belief's ERR is {_percent(summary['err_final'])}"]
        parts += [f"the free run's {_percent(summary['err_free_final'])}"] if study.free is not None else []
        # The difference between the truth and a map of zeros is the truth itself, so the ERR of such a map is 100 %.
        parts += ["an empty map's 100 %"] if scored.kind is Kind.NONNEGATIVE else []
    elif summary["innovation_rms"] is None:
        parts = ["there is no truth to compare the belief with"]
    else:
        parts = [f"the innovations' root mean square is {summary['innovation_rms']:.2f} (of an honest belief: 1)"]
    return (
        f"{summary['name']}, seed {summary['seed']}: after {summary['cycles']} cycles and "
        f"{said_of_readings(summary['readings'])} {', '.join(parts)} ({summary['wall_seconds']:.0f} s)"
    )


def _percent(value: float | None) -> str:
    return "not defined" if value is None else f"{value:.1f} %"


def warn_once(warned: set[str], what: str, text: str) -> None:
    """Log a warning, and print it on standard error, the first time that there is one about ``what``."""
    if what in warned:
        return
    warned.add(what)
    log.warning("%s", text)
    print(f"dafw: warning: {text}", file=sys.stderr)


def log_domain(parts: Parts) -> None:
    """Log what the model was built from, and where the readings come from."""
    for note in [*parts.model.notes(), *parts.readings.notes()]:
        log.info("%s", note)
    log.info("state: %r", parts.model.space)
    if parts.model.domain is not None:
        log.info("domain: %s m, %d obstacles", parts.model.domain.bounds, len(parts.model.domain.obstacles))
