"""``dafw run``: Hydra composes, launches and sweeps; dafw checks first and runs each job.

Everything is composed and checked before Hydra starts anything. So a wrong request costs no time, and a configuration
cannot run code that it names.
"""

from __future__ import annotations

import shutil
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from hydra._internal.hydra import Hydra
from hydra._internal.utils import get_args_parser
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig

from dafw.commands import said, status_of
from dafw.core.composition import (
    advised,
    compose,
    explained,
    quoted_override,
    require_fixed_folder,
    single_runs,
    study_hydra,
    study_part,
)
from dafw.core.errors import ComputationError, ConfigurationError, RunError
from dafw.core.experiment import study_from
from dafw.core.study import Study
from dafw.studies.following import follow_study
from dafw.studies.reporting import closing_line
from dafw.studies.resuming import is_complete, said_of_complete
from dafw.studies.running import SHOWN_BY_BUILDING, refuse_run, run_study
from dafw.studies.stopping import Interrupted

STATUSES = ".status"
"""Folder in a sweep in which its jobs store their exit statuses until the sweep is done."""


def run_command(words: Sequence[str], communicator: Any = None, *, resume: bool = False) -> int:
    """Run ``dafw run WORDS``; raises DafwError. With an MPI communicator, only rank 0 writes files and prints.

    With ``resume`` runs that are there already are not refused: unfinished ones go on, complete ones are left alone.
    """
    parser = get_args_parser()
    parser.error = _refuse  # type: ignore[method-assign]  # argparse would print its usage and exit
    asked = parser.parse_intermixed_args(list(words))
    if asked.config_path:
        raise ConfigurationError(
            "--config-path would replace what dafw ships; add a folder of your own by --config-dir"
        )
    if asked.experimental_rerun:
        raise ConfigurationError("--experimental-rerun would run what a file says, whoever wrote it")
    folder = Path(asked.config_dir).resolve() if asked.config_dir else None
    if folder is not None and not folder.is_dir():
        raise ConfigurationError(f"--config-dir {asked.config_dir}: there is no such folder")
    name, overrides = asked.config_name or "config", list(asked.overrides)
    follows = communicator is not None and communicator.rank > 0
    if asked.help or asked.hydra_help or asked.cfg or asked.info or asked.shell_completion:
        return 0 if follows else _show(parser, asked, overrides, folder, name)
    if asked.resolve:
        raise ConfigurationError("run: --resolve goes with --cfg")
    if communicator is not None and asked.multirun:
        raise ConfigurationError("mpirun works on one run: start the runs of a multirun one by one")
    sweep, jobs = None, list(single_runs(overrides)) if asked.multirun else [overrides]
    hydra = study_hydra(folder)
    placed: set[str] = set()
    for number, job in enumerate(jobs):
        if job in jobs[:number]:
            raise ConfigurationError(f"the multirun has the same job twice: {' '.join(job)}")
        config = compose(job, folder, name, hydra)
        if config.hydra.job.chdir:
            raise ConfigurationError("hydra.job.chdir would move relative paths: it is not supported")
        if config.hydra.mode not in (None, RunMode.MULTIRUN if asked.multirun else RunMode.RUN):
            raise ConfigurationError("hydra.mode follows the command: dafw run -m for a multirun, dafw run for one run")
        if not asked.multirun and config.get("resume") != "auto":
            refuse_run(Path(config.hydra.run.dir), communicator)
        try:
            composed = study_part(config)
            study = study_from(composed)
            if study.readings.reads_standard_input and len(jobs) > 1:
                raise ConfigurationError(
                    f"{study.readings.label}: the {len(jobs)} runs of the multirun would share one standard input: "
                    "give each a source of its own"
                )
            if composed["resume"] == "auto":
                require_fixed_folder(config, asked.multirun)
                if not asked.multirun and _is_complete(Path(config.hydra.run.dir).resolve(), study, communicator):
                    return 0
            # Some errors show only when a site or a mesh is built: build once for each different one.
            place = repr([composed.get(key) for key in SHOWN_BY_BUILDING])
            if place not in placed:
                study.prepare(communicator)
                placed.add(place)
        except ConfigurationError as error:
            raise advised(error, job, folder, name) from error
        if asked.multirun and sweep is None:
            sweep = Path(config.hydra.sweep.dir).resolve()
    if follows:
        return _follow(study, communicator)
    if len({word for job in jobs for word in job if word.startswith("experiment=")}) > 1:
        overrides.append("hydra.job.config.override_dirname.exclude_keys=[]")  # else two jobs could share a folder
    return _launch(hydra, name, overrides, sweep, len(jobs), communicator, resume)


def _show(parser: ArgumentParser, asked: Namespace, overrides: list[str], folder: Path | None, name: str) -> int:
    """Show Hydra's help, the composed configuration, or where its values come from."""
    if sum(map(bool, (asked.cfg, asked.info, asked.shell_completion, asked.run, asked.multirun))) > 1:
        raise ConfigurationError("run: expected only one of --run, --multirun, --cfg, --info and --shell-completion")
    asked.overrides = overrides
    hydra = study_hydra(folder)
    compose(overrides, folder, name, hydra)  # a wrong request, or one that names code, raises here
    if asked.help:
        hydra.app_help(name, parser, asked)
    elif asked.hydra_help:
        hydra.hydra_help(None, parser, asked)
    elif asked.cfg:
        hydra.show_cfg(name, overrides, asked.cfg, asked.package, asked.resolve)
    elif asked.info:
        hydra.show_info(asked.info, name, overrides)
    else:
        hydra.shell_completion(name, overrides)
    return 0


def _follow(study: Study, communicator: Any) -> int:
    try:
        follow_study(study, communicator)
    except Interrupted as stop:
        raise KeyboardInterrupt(str(stop)) from stop
    return 0


def _refuse(message: str) -> NoReturn:
    raise ConfigurationError(f"run: {message}")


def _launch(
    hydra: Hydra,
    name: str,
    overrides: list[str],
    sweep: Path | None,
    jobs: int,
    communicator: Any,
    resume: bool,
) -> int:
    """Run with Hydra; return the exit status of the job, or the worst exit status of the jobs of a sweep."""
    statuses: list[int] = []

    def job(config: DictConfig) -> None:
        hydra_config = HydraConfig.get()
        try:
            status = _run_job(config, Path(hydra_config.runtime.output_dir), communicator, resume)
        except Exception as error:
            line = said(error)
            if line is None and sweep is None:
                raise
            # Whatever the error is, the other jobs of a sweep must go on.
            status = status_of(error)
            print(f"dafw: {line or ' '.join(f'{type(error).__name__}: {error}'.split())}", file=sys.stderr)
        if sweep is None:
            statuses.append(status)
        else:  # a file, because a launcher may run the job in another process or machine
            (sweep / STATUSES).mkdir(exist_ok=True)
            (sweep / STATUSES / str(hydra_config.job.num)).write_text(str(status))

    try:
        if sweep is None:
            hydra.run(name, job, overrides)  # the words that were checked, so that they are not composed again
        else:
            hydra.multirun(
                name, job, [*overrides, quoted_override("hydra.sweep.dir", str(sweep)), "hydra.mode=MULTIRUN"]
            )
    except HydraException as error:
        raise explained(error) from error
    except Exception as error:
        if sweep is None:
            raise
        what = f"{type(error).__name__}: {error}"
        raise ComputationError(f"the launcher of the sweep failed: {what}; what is done is in {sweep}") from error
    if sweep is not None:
        for left in sorted((sweep / STATUSES).glob("*")):
            statuses.append(int(left.read_text()))
        shutil.rmtree(sweep / STATUSES, ignore_errors=True)
        if len(statuses) < jobs:
            print(f"dafw: {jobs - len(statuses)} of {jobs} runs left no word of how they ended", file=sys.stderr)
            statuses.append(1)
        print(sweep)
    return max(statuses, default=0)


def _is_complete(folder: Path, study: Study, communicator: Any) -> bool:
    """Return whether a folder holds the complete run of a study, and say so; raises RunError for another run.

    With an MPI communicator all ranks call this, and rank 0 looks.
    """
    complete, refusal = False, ""
    if communicator is None or communicator.rank == 0:
        try:
            complete = is_complete(folder, study)
        except RunError as error:
            refusal = str(error)
    if communicator is not None:
        complete, refusal = communicator.bcast((complete, refusal), root=0)
    if refusal:
        raise RunError(refusal)
    if complete and (communicator is None or communicator.rank == 0):
        print(f"{said_of_complete(folder)}\n{folder}")
    return complete


def _run_job(config: DictConfig, folder: Path, communicator: Any, resume: bool) -> int:
    """Run one study into its folder, print how it ended, and return the exit status."""
    try:
        composed = study_part(config)
        study = study_from(composed)
        resume = resume or composed["resume"] == "auto"
        if resume and communicator is None and is_complete(folder, study):
            return 0
        summary = run_study(study, folder, communicator, resume=resume)
    except Interrupted as stop:
        raise KeyboardInterrupt(str(stop)) from stop
    print(closing_line(study, summary))
    print(folder, flush=True)
    return 0
