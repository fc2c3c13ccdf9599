"""``dafw run``: Hydra composes, launches and sweeps; dafw checks first and runs each job.

Everything is composed and checked before Hydra starts anything, so that a wrong request costs nothing and no
configuration has code run that it names itself.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import hydra
from hydra._internal.utils import get_args_parser
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from dafw.core.composition import compose, config_folder, explained, register_schemas, single_runs, study_part
from dafw.core.errors import ComputationError, ConfigurationError, DafwError
from dafw.core.experiment import study_from
from dafw.core.study import Study
from dafw.studies.running import follow_study, refuse_run, run_study
from dafw.studies.stopping import Interrupted

STATUSES = ".status"
"""Folder in a sweep where its jobs leave their exit statuses until it is done."""

SHOWN_BY_BUILDING = ("model", "truth", "free", "vehicle", "observer", "policy", "readings", "section")
"""What of a study's configuration can be wrong in ways that only a site or a mesh shows."""


def run_command(words: Sequence[str], communicator: Any = None) -> int:
    """Run ``dafw run WORDS``; raises DafwError. Of the ranks of an MPI communicator, rank 0 writes and speaks."""
    parser = get_args_parser()
    parser.error = _refuse  # type: ignore[method-assign]  # argparse would print its usage and exit
    asked = parser.parse_intermixed_args(list(words))
    if asked.config_path:
        raise ConfigurationError(
            "--config-path would replace what dafw ships; add a folder of your own by --config-dir"
        )
    # Hydra itself wants the flags first.
    words = [word for word in words if word not in asked.overrides] + asked.overrides
    folder = Path(asked.config_dir).resolve() if asked.config_dir else None
    if folder is not None and not folder.is_dir():
        raise ConfigurationError(f"--config-dir {asked.config_dir}: there is no such folder")
    follows = communicator is not None and communicator.rank > 0
    shown = asked.help or asked.hydra_help or asked.cfg or asked.info or asked.shell_completion
    directories = [f"hydra.searchpath=[file://{folder}]"] if folder else []
    if communicator is not None and asked.multirun:
        raise ConfigurationError("mpirun works on one run: start the runs of a multirun one by one")
    sweep, jobs = None, list(single_runs(asked.overrides)) if asked.multirun else [list(asked.overrides)]
    if not shown:
        placed: set[str] = set()
        for number, job in enumerate(jobs):
            if job in jobs[:number]:
                raise ConfigurationError(f"the multirun has the same job twice: {' '.join(job)}")
            config = compose([*job, *directories], name=asked.config_name or "config")
            if config.hydra.job.chdir:
                raise ConfigurationError("hydra.job.chdir would move relative paths: it is not supported")
            if not asked.multirun:
                refuse_run(Path(config.hydra.run.dir))
            composed = study_part(config)
            study = study_from(composed)
            # Building the parts shows what only a site or a mesh can tell; once for each place is enough.
            place = repr([composed.get(key) for key in SHOWN_BY_BUILDING])
            if place not in placed:
                study.prepare(communicator)
                placed.add(place)
            if asked.multirun and sweep is None:
                sweep = Path(config.hydra.sweep.dir).resolve()
    if follows:
        return 0 if shown else _follow(study, communicator)
    return _launch(list(words), sweep, len(jobs), communicator)


def _follow(study: Study, communicator: Any) -> int:
    try:
        follow_study(study, communicator)
    except Interrupted as stop:
        raise KeyboardInterrupt(str(stop)) from stop
    return 0


def _refuse(message: str) -> NoReturn:
    raise ConfigurationError(f"run: {message}")


def _launch(words: list[str], sweep: Path | None, jobs: int, communicator: Any = None) -> int:
    """Hand over to Hydra; return the exit status of the job, or of the worst of those of a sweep into a folder."""
    register_schemas()
    statuses: list[int] = []
    if sweep is not None:
        words = [*words, _override("hydra.sweep.dir", sweep)]

    def job(config: DictConfig) -> None:
        hydra_config = HydraConfig.get()
        status = _run_job(config, Path(hydra_config.runtime.output_dir), communicator)
        if sweep is None:
            statuses.append(status)
        else:  # a launcher may run the job in another process, on another machine
            (sweep / STATUSES).mkdir(exist_ok=True)
            (sweep / STATUSES / str(hydra_config.job.num)).write_text(str(status))

    # Hydra would turn errors into its own text and status.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    previous, sys.argv = sys.argv, ["dafw run", *words]
    try:
        hydra.main(version_base="1.3", config_path=str(config_folder()), config_name="config")(job)()
    except (hydra.errors.HydraException, hydra.errors.ConfigCompositionException) as error:
        raise explained(error) from error
    except Exception as error:
        if sweep is None:
            raise
        what = f"{type(error).__name__}: {error}"
        raise ComputationError(f"the launcher of the sweep failed: {what}; what is done is in {sweep}") from error
    finally:
        sys.argv = previous
    if sweep is not None:
        for left in sorted((sweep / STATUSES).glob("*")):
            statuses.append(int(left.read_text()))
        shutil.rmtree(sweep / STATUSES, ignore_errors=True)
        if len(statuses) < jobs:
            print(f"dafw: {jobs - len(statuses)} of {jobs} runs left no word of how they ended", file=sys.stderr)
            statuses.append(1)
        print(sweep)
    return max(statuses, default=0)


def _override(key: str, value: Path) -> str:
    """Return an override in Hydra's grammar, quoted."""
    quoted = str(value).replace("\\", "\\\\").replace("'", "\\'")
    return f"{key}='{quoted}'"


def _run_job(config: DictConfig, folder: Path, communicator: Any) -> int:
    """Run one study into its folder, say how it went, and return the exit status."""
    try:
        summary = run_study(study_from(study_part(config)), folder, communicator)
    except DafwError as error:
        print(f"dafw: {' '.join(str(error).split())}", file=sys.stderr)
        return error.exit_status
    except Interrupted as stop:
        raise KeyboardInterrupt(str(stop)) from stop
    print(closing_line(summary))
    print(folder, flush=True)
    return 0


def closing_line(summary: dict[str, Any]) -> str:
    """Return how the belief did against the free run, in one sentence."""

    def percent(value: float | None) -> str:
        return "not defined" if value is None else f"{value:.1f} %"

    return (
        f"{summary['name']}, seed {summary['seed']}: after {summary['cycles']} cycles the belief's ERR is "
        f"{percent(summary['err_final'])}, the free run's {percent(summary['err_free_final'])} "
        f"({summary['wall_seconds']:.0f} s)"
    )
