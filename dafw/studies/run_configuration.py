"""The configuration that a run left in its folder, and the study that it describes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import chdir, contextmanager, suppress
from pathlib import Path
from typing import Any

import yaml

from dafw.core.errors import ConfigurationError, RunError
from dafw.core.runs import summary_of

CONFIGURATION, HYDRA = ".hydra/config.yaml", ".hydra/hydra.yaml"


def configuration_of(folder: Path) -> dict[str, Any]:
    """Return the composed configuration of a run, as plain values. Nothing that it names is executed.

    Raises RunError if the folder holds none, ConfigurationError for one that is not accepted.
    """
    from omegaconf import DictConfig, OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    from dafw.core.composition import refuse_code, study_part

    file = folder / CONFIGURATION
    if not file.is_file():
        if (folder / "run.nc").exists():
            raise RunError(
                f"{folder}: its run was made of Python objects (there is no {CONFIGURATION}): "
                f"dafw.run(study, folder, resume=True) goes on with it"
            )
        raise RunError(f"{folder}: holds no run, multirun or study (expected {CONFIGURATION} in it)")
    try:
        config = OmegaConf.load(file)
    except (OSError, UnicodeError, yaml.YAMLError, OmegaConfBaseException) as error:
        raise RunError(f"{file}: cannot be read ({' '.join(str(error).split())})") from error
    if not isinstance(config, DictConfig):
        raise RunError(f"{file}: cannot be read (it is no mapping)")
    try:
        refuse_code(config)
        return study_part(config)
    except ConfigurationError as error:
        raise type(error)(f"{file}: {error}") from error


@contextmanager
def in_working_folder(folder: Path) -> Iterator[None]:
    """Work during the block where the run was begun, because relative paths in its configuration count from there."""
    place = summary_of(folder).get("working_folder") or _told_by_hydra(folder / HYDRA)
    if isinstance(place, str) and Path(place).is_dir():
        with chdir(place):
            yield
    else:
        yield


def _told_by_hydra(file: Path) -> Any:
    with suppress(OSError, UnicodeError, yaml.YAMLError, LookupError, TypeError):
        return yaml.safe_load(file.read_text(encoding="utf-8"))["hydra"]["runtime"]["cwd"]
    return None
