"""``dafw.run``: a study from Python, made of objects or composed from overrides."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from dafw.core.errors import ConfigurationError
from dafw.core.files import write_atomically
from dafw.core.study import Study
from dafw.studies.resuming import holds_run, is_complete
from dafw.studies.running import refuse_run, run_study


def run(what: Study | list[str] | None = None, folder: str | Path | None = None, *, resume: bool = False) -> Any:
    """Run a study and open its result as an xarray.Dataset; the attribute ``folder`` is the folder of the run.

    ``dafw.run(study)`` runs a study made of objects; ``dafw.run(["filter=none", "cycles=20"])`` composes one from
    overrides, as the command does. The run is written to ``folder``, or to a new folder in ``outputs``. With ``resume``
    an unfinished run of the same study in ``folder`` goes on from its last checkpoint, and a complete one is opened.
    Raises ConfigurationError for a wrong request, RunError if the folder already holds a run, or one that cannot go on,
    and other DafwErrors if a computation fails.
    """
    from dafw.core.runs import open_run

    if resume and folder is None and isinstance(what, Study):
        raise ConfigurationError("dafw.run: resume=True needs the folder of the run: folder=...")
    if isinstance(what, Study):
        place = Path(folder or f"outputs/{what.name}/{datetime.now():%Y-%m-%d_%H-%M-%S-%f}").resolve()
        run_study(what, place, resume=resume)
    else:
        place = _run_overrides(what or [], folder, resume)
    dataset = open_run(place)
    dataset.attrs["folder"] = str(place)
    return dataset


def _run_overrides(overrides: list[str], folder: str | Path | None, resume: bool) -> Path:
    """Compose and run a study; return its folder."""
    from dafw.core.composition import advised, compose, require_fixed_folder, study_part
    from dafw.core.experiment import study_from

    if not isinstance(overrides, list | tuple) or not all(isinstance(override, str) for override in overrides):
        raise ConfigurationError(f"dafw.run expects a Study, or a list of overrides as strings; got {overrides!r}")
    config = compose(overrides)
    composed = study_part(config)
    place = Path(folder or config.hydra.run.dir).resolve()
    resume = resume or composed["resume"] == "auto"
    if resume and folder is None:
        require_fixed_folder(config)
    if not resume:
        refuse_run(place)
    try:
        study = study_from(composed)
        if not (resume and holds_run(place)):
            study.prepare()
    except ConfigurationError as error:
        raise advised(error, overrides) from error
    if not (resume and is_complete(place, study)):
        keep_configuration(place / ".hydra", composed, overrides)
    run_study(study, place, resume=resume)
    return place


def keep_configuration(folder: Path, composed: Mapping[str, Any], overrides: list[str]) -> None:
    """Write a study's configuration, as the command does; before it runs, so that a failed run has it, too."""
    from omegaconf import OmegaConf

    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / "config.yaml", OmegaConf.to_yaml(dict(composed)))
    write_atomically(folder / "overrides.yaml", OmegaConf.to_yaml(overrides))
