"""From where a run goes on: what its folder holds, and whether that fits the study."""

from __future__ import annotations

import logging
import shutil
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from dafw.core.checkpoints.checkpoint_file import FOLDER, Checkpoint, checkpoints, read_checkpoint
from dafw.core.checkpoints.fingerprint import (
    changed_files,
    changed_since,
    changed_versions,
    compared,
    described,
    difference,
    digest,
    digests_of_files,
    start_digest,
)
from dafw.core.checkpoints.journal import FORECASTS, ROWS, entries
from dafw.core.checkpoints.values import unpacked
from dafw.core.cycle import Parts, State
from dafw.core.errors import CheckpointError, DafwError, RunError
from dafw.core.forecasts.forecast_file import FILE
from dafw.core.runs import summary_of
from dafw.core.study import Study
from dafw.studies.run_configuration import configuration_of
from dafw.studies.summary import versions_of

log = logging.getLogger("dafw")

LOCK = ".lock"
OTHER = "to run another configuration, choose another folder"


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Keep other processes from writing a run in the folder during the block; raises RunError if one does."""
    lock = FileLock(folder / LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise RunError(f"{folder}: another process is writing this run; nothing was changed") from None
    except NotImplementedError:
        log.info("%s: this file system has no locks; nothing keeps a second process from writing here", folder)
    try:
        yield
    finally:
        lock.release()


def holds_run(folder: Path) -> bool:
    """Return whether a folder holds a run, finished or not."""
    return (folder / "run.nc").exists() or (folder / "summary.json").exists()


def is_complete(folder: Path, study: Study) -> bool:
    """Return whether a folder holds the complete run of a study.

    Raises RunError if it holds a run of another configuration, a complete one of which it is not known, or a complete
    one that read files which have changed.
    """
    if not holds_run(folder):
        return False
    summary = summary_of(folder)
    known, complete = summary.get("configuration"), summary.get("status") == "complete"
    if not known and complete:  # of an older version: its configuration must be the same word for word
        known = digest(compared(configuration_of(folder)))
    if known and known != digest(described(study)):
        raise RunError(f"{folder}: {_other(folder, study)}; {OTHER}")
    if complete:
        require_same_files([folder])
    return complete


def require_same_files(folders: Iterable[Path]) -> None:
    """Raise RunError if a file that the complete run in one of the folders read has changed; it may be gone."""
    now: dict[str, str] = {}
    for folder in folders:
        if changed := changed_since(summary_of(folder).get("files") or {}, now):
            raise RunError(
                f"{folder}: its run is complete, but files that it read are other ones now: {', '.join(changed)}; to "
                f"run with them, choose another folder"
            )


def said_of_complete(folder: Path) -> str:
    """Return in words that a run is complete, without building its model."""
    summary = summary_of(folder)
    return f"{summary.get('name')}, seed {summary.get('seed')}: complete already, {summary.get('cycles')} cycles"


def last_checkpoint(folder: Path, study: Study) -> Checkpoint | None:
    """Return the newest checkpoint of an unfinished run that is whole, with its journals; None if there is none yet.

    Raises CheckpointError if all are damaged; RunError if the run had another configuration or other versions, or if
    it is not known which.
    """
    files = checkpoints(folder / FOLDER)
    errors: list[CheckpointError] = []
    for path in files:
        try:
            found = read_checkpoint(path)
            for name in (ROWS, FORECASTS):
                if name in found.told["journals"]:
                    deque(entries(folder / FOLDER / name, found.told["journals"][name]), maxlen=0)
        except CheckpointError as error:
            errors.append(error)
            continue
        _require_same(folder, study, found)
        for damaged, failure in zip(files, errors, strict=False):
            log.warning("%s; the run goes on from the one before", failure)
            damaged.unlink()  # its journals are cut now
        return found
    if errors:
        raise CheckpointError(
            f"{errors[0]}; no checkpoint of this run can be used: remove {folder / FOLDER} to run it from the start"
        )
    if (folder / "run.nc").exists() and not summary_of(folder).get("configuration"):
        raise RunError(f"{folder}: its run has no checkpoint, and it is not known what it computed; {OTHER}")
    return None


def _require_same(folder: Path, study: Study, found: Checkpoint) -> None:
    if (before := found.told["configuration"]) != (now := described(study)):
        raise RunError(f"{folder}: its run had {difference(before, now)}; {OTHER}")
    if changed := changed_versions(found.told["versions"], versions_of(study)):
        raise RunError(
            f"{folder}: its run cannot go on to the same bits with other versions: {', '.join(changed)}; install the "
            f"former ones, or run it anew in another folder"
        )
    files = digests_of_files(study)
    if changed := changed_files(found.told.get("files", files), files):
        raise RunError(
            f"{folder}: its run cannot go on, because files that it read are other ones now: {', '.join(changed)}; to "
            f"run with them, choose another folder"
        )


def _other(folder: Path, study: Study) -> str:
    """Return how the configuration of a run in a folder differs from a study's."""
    now = described(study)
    for path in checkpoints(folder / FOLDER):
        with suppress(CheckpointError):
            if (before := read_checkpoint(path).told["configuration"]) != now:
                return f"its run had {difference(before, now)}"
    with suppress(DafwError):  # of a run that was made of objects it cannot be told
        if study.configuration is not None and (before := compared(configuration_of(folder))) != now:
            return f"its run had {difference(before, now)}"
    return "its run had another configuration"


def restored(checkpoint: Checkpoint, start: State, parts: Parts, folder: Path) -> State:
    """Return the state of a checkpoint; ``start`` is the one that the study has at its start now.

    Raises RunError if that is not the one with which the run began, CheckpointError if the state cannot be read.
    """
    if (before := checkpoint.told["start"]) != (now := start_digest(start)):
        parts_of = zip(("belief", "truth", "free run"), before.split(), now.split(), strict=False)
        changed = " and ".join(name for name, one, other in parts_of if one != other)
        raise RunError(
            f"{folder}: the {changed} at the start differs from that with which the run began: a file or a plugin that "
            f"the study needs has changed, or the machine is another one"
        )
    try:
        return unpacked(checkpoint.told["state"], parts, checkpoint.arrays)
    except CheckpointError as error:
        raise CheckpointError(f"{folder / FOLDER}: {error}") from error


def cleared(folder: Path) -> None:
    """Remove what an unfinished run without a checkpoint left, so that it can start again."""
    for name in ("run.nc", FILE):
        (folder / name).unlink(missing_ok=True)
    shutil.rmtree(folder / FOLDER, ignore_errors=True)


def later_rows(checkpoint: Checkpoint, prefix: str) -> Mapping[str, Any]:
    """Return the arrays of a checkpoint under a prefix, by the rest of their names."""
    return {name.removeprefix(prefix): one for name, one in checkpoint.arrays.items() if name.startswith(prefix)}


def shared(checkpoint: Checkpoint | None, communicator: Any) -> Checkpoint | None:
    """Return rank 0's checkpoint on all ranks of an MPI communicator, if there is one; all of them call this."""
    if communicator is None:
        return checkpoint
    needed = ("start", "state", "pinned")
    mine = None if checkpoint is None else (checkpoint.cycle, {name: checkpoint.told[name] for name in needed})
    told = communicator.bcast(None if mine is None or checkpoint is None else (*mine, dict(checkpoint.arrays)), root=0)
    return checkpoint if communicator.rank == 0 or told is None else Checkpoint(*told)
