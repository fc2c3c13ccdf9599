"""``dafw run``: Hydra composes, launches and sweeps; dafw checks first and runs each job.

Everything is composed and checked before Hydra starts anything, so that a wrong request costs nothing and no
configuration has code run that it names itself.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import hydra
from hydra._internal.utils import get_args_parser
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from dafw.core.composition import compose, config_folder, explained, register_schemas, single_runs, study_part
from dafw.core.errors import ConfigurationError, DafwError
from dafw.core.experiment import assemble, study_from
from dafw.running import run_study
from dafw.stopping import Interrupted


def run_command(words: Sequence[str]) -> int:
    """Run ``dafw run WORDS``; raises DafwError."""
    try:
        asked = get_args_parser().parse_intermixed_args(list(words))
    except SystemExit as stop:
        # argparse has printed what it had to say: the version, or which flag is wrong.
        return 2 if stop.code else 0
    # Hydra itself wants the flags first.
    words = [word for word in words if word not in asked.overrides] + asked.overrides
    folder = Path(asked.config_dir).resolve() if asked.config_dir else None
    if folder is not None and not folder.is_dir():
        raise ConfigurationError(f"--config-dir {asked.config_dir}: there is no such folder")
    shown = asked.help or asked.hydra_help or asked.cfg or asked.info or asked.shell_completion
    directories = [f"hydra.searchpath=[file://{folder}]"] if folder else []
    if not shown:
        placed = set()
        for job in single_runs(asked.overrides) if asked.multirun else [list(asked.overrides)]:
            study = study_from(study_part(compose([*job, *directories], name=asked.config_name or "config")))
            # Building the parts shows what only a site or a mesh can tell; once for each place is enough.
            place = repr((study.model, study.truth, study.free, study.vehicle))
            if place not in placed:
                assemble(study)
                placed.add(place)
    return _launch(list(words), multirun=bool(asked.multirun and not shown))


def _launch(words: list[str], *, multirun: bool) -> int:
    """Hand over to Hydra; return the exit status of the job, or of the worst of them."""
    register_schemas()
    statuses: list[int] = []
    folders: list[str] = []

    def job(config: DictConfig) -> None:
        hydra_config = HydraConfig.get()
        folders.append(hydra_config.sweep.dir if multirun else hydra_config.runtime.output_dir)
        try:
            summary = run_study(study_from(study_part(config)), Path(hydra_config.runtime.output_dir))
        except DafwError as error:
            print(f"dafw: {' '.join(str(error).split())}", file=sys.stderr)
            statuses.append(error.exit_status)
            return
        except Interrupted as stop:
            raise KeyboardInterrupt(str(stop)) from stop
        statuses.append(0)
        print(closing_line(summary))
        print(hydra_config.runtime.output_dir)

    # Hydra would turn errors into its own text and status.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    previous, sys.argv = sys.argv, ["dafw run", *words]
    try:
        hydra.main(version_base="1.3", config_path=str(config_folder()), config_name="config")(job)()
    except (hydra.errors.HydraException, hydra.errors.ConfigCompositionException) as error:
        raise explained(error) from error
    finally:
        sys.argv = previous
    if multirun and folders:
        print(Path(folders[0]).resolve())
    return max(statuses, default=0)


def closing_line(summary: dict[str, Any]) -> str:
    """Return how the belief did against the free run, in one sentence."""

    def percent(value: float | None) -> str:
        return "not defined" if value is None else f"{value:.1f} %"

    return (
        f"{summary['name']}, seed {summary['seed']}: after {summary['cycles']} cycles the belief's ERR is "
        f"{percent(summary['err_final'])}, the free run's {percent(summary['err_free_final'])} "
        f"({summary['wall_seconds']:.0f} s)"
    )
