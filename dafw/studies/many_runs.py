"""The folder of a study of many runs: what was asked for, which runs are there, and running those that are missing.

FOLDER/request.json                       the composed configurations, so that other ones are never mixed in
FOLDER/runs/CONFIGURATION/seed=N/         one run each, as ``dafw run`` leaves it
FOLDER/floors.json                        the floors, where the study file asks for them (``dafw.studies.floors``)
FOLDER/study.nc, summary.json, table.md, figures/    the results (``dafw.studies.results``)
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from dafw.core.checkpoints.fingerprint import difference
from dafw.core.composition import advised, compose, study_hydra, study_part
from dafw.core.errors import ConfigurationError, RunError
from dafw.core.experiment import study_from
from dafw.core.files import write_atomically
from dafw.core.progress import progress
from dafw.core.study import Study
from dafw.core.workers import cores
from dafw.studies.floors import composed_for_floors, find_floors, named
from dafw.studies.reporting import log_file
from dafw.studies.resuming import require_same_files
from dafw.studies.running import SHOWN_BY_BUILDING
from dafw.studies.side_by_side import Task, run_side_by_side, status_of_run
from dafw.studies.stopping import Interrupted, stop_signals
from dafw.studies.study_files import Configuration, ManyRuns, runs_of

log = logging.getLogger("dafw")

REQUEST = "request.json"
RUNS = "runs"
TO_BE_RUN = ("missing", "interrupted")


def run_folder(folder: Path, configuration: Configuration, seed: int) -> Path:
    """Return the folder of one run."""
    return folder / RUNS / configuration.name / f"seed={seed}"


def statuses(study: ManyRuns, folder: Path) -> dict[tuple[str, int], str]:
    """Return how each run of a study ended (complete, failed, interrupted, missing), by configuration and seed."""
    return {(one.name, seed): status_of_run(run_folder(folder, one, seed)) for one, seed in runs_of(study)}


def composed(study: ManyRuns, more: Path | None = None) -> dict[str, Any]:
    """Return the composed configuration of each of a study's configurations, without the seed.

    Raises ConfigurationError, which names the configuration, for one that is not accepted.
    """
    hydra = study_hydra(more)
    found: dict[str, Any] = {}
    for one in study.configurations:
        words = list(one.overrides)
        try:
            values = study_part(compose(words, more, hydra=hydra))
            _require_own_source(study_from(values))
        except ConfigurationError as error:
            raise named(one, advised(error, words, more)) from error
        for name in ("seed", "resume", "checkpoint"):  # they do not tell one configuration from another
            values.pop(name)
        found[one.name] = json.loads(json.dumps(values))
    return found


def _require_own_source(study: Study) -> None:
    """Raise ConfigurationError for readings that come through standard input, which the runs cannot share."""
    if study.readings.reads_standard_input:
        raise ConfigurationError(
            f"{study.readings.label}: the runs of a study have no standard input to read from: expected another source"
        )


def run_missing(
    study: ManyRuns,
    folder: Path,
    *,
    whole: ManyRuns | None = None,
    more: Path | None = None,
    workers: int | None = None,
    retry: bool = False,
    command: Mapping[str, Any] | None = None,
) -> int:
    """Run what is missing of a study, in so many processes (one per core), and return how many runs were started.

    With ``retry`` failed runs are run again. ``whole`` is the study of which this is a part: its configurations
    belong to the folder, too. ``command`` is what the folder keeps so that it can be resumed. Before anything is run,
    everything is composed and checked. Raises ConfigurationError for a wrong request, also if the folder's
    configurations are not the study's; RunError if another process works in the folder; Interrupted, which says how
    many runs there are; another DafwError if a floor cannot be found.
    """
    configurations = composed(whole or study, more)
    for_floors = composed_for_floors(study, more)
    workers = workers or cores()
    for one in study.configurations:
        executor = configurations[one.name]["executor"]["name"]
        if executor != "serial" and workers > 1:
            raise ConfigurationError(
                f"configuration '{one.name}': executor '{executor}' starts processes of its own, and so does a study: "
                f"expected executor=serial, or --workers 1"
            )
    require_same(folder, configurations)
    again = (*TO_BE_RUN, "failed") if retry else TO_BE_RUN
    with _held(folder), log_file(folder / "study.log"), stop_signals():
        there = statuses(study, folder)
        complete = [
            run_folder(folder, one, seed) for one, seed in runs_of(study) if there[one.name, seed] == "complete"
        ]
        require_same_files(complete)
        todo = [(one, seed) for one, seed in runs_of(study) if there[one.name, seed] in again]
        tasks = [Task(one.overrides, seed, run_folder(folder, one, seed), more) for one, seed in todo]
        try:
            if tasks:
                _make_ready({one.name: one for one, _ in todo}, configurations)
            _note_request(folder, configurations, command)
            find_floors(study, folder, for_floors)
            _run(tasks, len(there), workers)
        except KeyboardInterrupt:
            ended = sum(status not in TO_BE_RUN for status in statuses(study, folder).values())
            raise Interrupted(
                f"{ended} of {len(there)} runs are kept in {folder}; the same command does the others"
            ) from None
    return len(tasks)


def _run(tasks: list[Task], total: int, workers: int) -> None:
    """Run the tasks with a progress bar, and log how each run ended."""
    failed = 0
    with (
        progress(total, "run", done=total - len(tasks)) as bar,
        closing(run_side_by_side(tasks, workers)) as running,
    ):
        for task, error in running:
            failed += bool(error)
            log.log(logging.WARNING if error else logging.INFO, "%s: %s", task.folder, error or "complete")
            bar.set_postfix_str(f"{failed} failed" if failed else "", refresh=False)
            bar.update()


def require_same(folder: Path, configurations: Mapping[str, Any]) -> None:
    """Raise ConfigurationError if a folder holds runs of other configurations than these; new ones may be added."""
    advice = "choose another --folder, or remove this one"
    for name, noted in _noted(folder).items():
        if name not in configurations:
            raise ConfigurationError(f"{folder}: holds runs of '{name}', which the study no longer has; {advice}")
        if noted != configurations[name]:
            what = difference(noted, configurations[name])
            raise ConfigurationError(f"{folder}: its runs of '{name}' had {what}; {advice}")


def _noted(folder: Path) -> dict[str, Any]:
    """Return the configurations for which a folder was made; raises RunError if it holds something else."""
    file = folder / REQUEST
    if not file.exists():
        if folder.is_dir() and any(entry.name not in (".lock", "study.log") for entry in folder.iterdir()):
            raise RunError(f"{folder}: is not empty and not the folder of a study (it has no {REQUEST})")
        return {}
    try:
        return dict(json.loads(file.read_text(encoding="utf-8"))["configurations"])
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise RunError(f"{file}: cannot be read ({' '.join(str(error).split())})") from error


def _note_request(folder: Path, configurations: Mapping[str, Any], command: Mapping[str, Any] | None) -> None:
    require_same(folder, configurations)  # another process may have come first, before this one had the lock
    told = {"configurations": configurations, **({} if command is None else {"command": command})}
    write_atomically(folder / REQUEST, json.dumps(told, indent=1) + "\n")


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    """Keep other processes from working in the folder during the block."""
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder / ".lock", timeout=0):
            yield
    except Timeout:
        raise RunError(f"{folder}: another process is working on this study") from None


def _make_ready(configurations: Mapping[str, Configuration], values: Mapping[str, Any]) -> None:
    """Build once, with all cores, what the runs would otherwise each build: a mesh, a reduced basis.

    Raises ConfigurationError, which names the configuration, for errors that only show then.
    """
    placed: set[str] = set()
    for name, one in configurations.items():
        place = repr([values[name].get(key) for key in SHOWN_BY_BUILDING])
        if place in placed:
            continue
        placed.add(place)
        study = study_from(values[name])
        try:
            study.prepare()
            for model in study.models.values():
                model.pinned_options()  # finds, and so makes, what the options leave open
        except ConfigurationError as error:
            raise named(one, error) from error
