"""Many runs side by side in worker processes. Each run is an ordinary one, in a folder of its own."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import shutil
from collections import Counter
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import cache
from multiprocessing.connection import wait
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dafw.core.errors import ComputationError, RunError, in_one_line
from dafw.core.files import write_atomically
from dafw.core.runs import summary_of
from dafw.core.workers import Outcome, Worker, dismiss, outcome

if TYPE_CHECKING:
    from dafw.core.study import Study

log = logging.getLogger("dafw")

ATTEMPTS = 2
"""How often a run is started whose worker process is lost, before it counts as failed."""


@dataclass(frozen=True)
class Task:
    """One run: its overrides without the seed, the seed, its folder, and a folder to search for configuration first."""

    overrides: tuple[str, ...]
    seed: int
    folder: Path
    more: Path | None = None


def run_side_by_side(tasks: Sequence[Task], workers: int) -> Generator[tuple[Task, str]]:
    """Run all tasks in so many processes; yield each as it ends, with its error message ('' if it succeeded).

    A run that fails leaves a ``summary.json`` that says so, even if it failed before it could write anything. If the
    generator is closed, by an interrupt for example, the workers are ended; what they were running is not finished.
    """
    todo, at, lost = list(tasks)[::-1], dict[Worker, Task](), Counter[Path]()
    pool: list[Worker] = []
    try:
        while todo or at:
            while todo and len(at) < workers:
                idle = [worker for worker in pool if worker not in at]
                if not idle:
                    pool.append(worker := Worker())
                    idle = [worker]
                at[idle[0]] = todo.pop()
                idle[0].ask(run_task, at[idle[0]])
            ready = wait([worker.connection for worker in at])
            for worker in [worker for worker in at if worker.connection in ready]:
                task, received = at.pop(worker), worker.receive()
                if received is not None:
                    yield task, received.value or ""
                    continue
                pool.remove(worker)
                message = f"the worker {worker.lost()}"
                lost[task.folder] += 1
                if lost[task.folder] < ATTEMPTS:
                    log.warning("%s: %s; it is run again", task.folder, message)
                    todo.append(task)
                else:
                    note_failure(task, message)
                    yield task, message
    finally:
        dismiss(pool)


def run_task(task: Task) -> Outcome:
    """Run a task in this worker process; the value is the error message, '' if it succeeded."""
    # A progress bar and warnings of one run among many: its log has them.
    with contextlib.redirect_stderr(io.StringIO()):
        done = outcome("the run", lambda: _run(task))
    if done.error is not None:
        message = in_one_line(done.error)
        note_failure(task, message)
        return Outcome(message)
    return Outcome("")


def _run(task: Task) -> None:
    from dafw.core.composition import compose, study_part
    from dafw.core.experiment import study_from
    from dafw.studies.from_python import keep_configuration
    from dafw.studies.running import run_study

    overrides = [*task.overrides, f"seed={task.seed}"]
    composed = study_part(compose(overrides, hydra=_hydra(task.more)))
    study = study_from(composed)
    # What a run left that was interrupted, or that failed and is tried again: it goes on if it can.
    if task.folder.exists() and not _can_go_on(task.folder, study):
        shutil.rmtree(task.folder)
    keep_configuration(task.folder / ".hydra", composed, overrides)
    run_study(study, task.folder, resume=True)


def _can_go_on(folder: Path, study: Study) -> bool:
    """Return whether an unfinished run has a checkpoint that fits; if it has one that does not, say why."""
    from dafw.studies.resuming import last_checkpoint

    try:
        return last_checkpoint(folder, study) is not None
    except RunError as error:
        log.warning("%s; it is run from the start", error)
        return False


@cache
def _hydra(more: Path | None) -> Any:
    """Return what composes the runs of this process; making it takes longer than composing."""
    from dafw.core.composition import study_hydra

    return study_hydra(more)


def note_failure(task: Task, message: str) -> None:
    """Leave a summary that says how a run failed, unless the run itself did."""
    file = task.folder / "summary.json"
    if status_of_run(task.folder) == "failed":
        return
    known = summary_of(task.folder)
    try:
        task.folder.mkdir(parents=True, exist_ok=True)
        write_atomically(file, json.dumps({"seed": task.seed, **known, "status": "failed", "error": message}, indent=2))
    except OSError as error:
        raise ComputationError(f"{task.folder}: cannot be written ({error}), after: {message}") from error


def status_of_run(folder: Path) -> str:
    """Return how a run ended: complete, failed or interrupted (also by a kill); ``missing`` if it left no word."""
    return str(summary_of(folder).get("status", "missing"))
