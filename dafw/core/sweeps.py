"""Opening a multirun: one lazy Dataset over all of its runs, with the swept parameters as dimensions."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dafw.core.errors import DafwError, RunError
from dafw.core.runs import open_run

if TYPE_CHECKING:
    import xarray

RECORD = "multirun.yaml"
"""The file in which Hydra stores the request of a multirun."""
SET_BY_DAFW = ("hydra.mode=", "hydra.sweep.dir=", "hydra.job.config.override_dirname.exclude_keys=")
"""Overrides of Hydra's part that ``dafw run`` adds itself."""
SWEEP_FOLDER = "sweep_folder"
"""The attribute of an open sweep that says where it is."""
SPARSEST = 100
"""If the grid has this many times more places than there are runs, the runs do not form a grid."""


def open_sweep(path: str | Path) -> xarray.Dataset:
    """Open the folder of a multirun as one lazy Dataset, with a dimension for each parameter that was swept.

    The coordinates of a dimension are the parameter's values as int, float, bool or str. For every run ``status`` says
    how it ended (``complete``, ``interrupted``, ``failed``, or ``missing`` if it left no summary) and ``folder`` where
    it is. Values that a run does not have are NaN, or '' for texts: all values of a missing run, the later rows of a
    run that ended early, the further members and nodes of a run that has fewer. Variables without time that are the
    same in all runs, such as a mesh, are stored once. Runs with different time steps are aligned by row, and
    ``row_time`` holds their times. The attribute ``sweep_folder`` says where the sweep is. Close the Dataset when done,
    or use it in a ``with`` block.

    Raises RunError if the folder is not a multirun, or its runs cannot be put into one grid.
    """
    import dafw.core.accessor  # noqa: F401 - so that the Dataset has ``dafw``
    from dafw.core.grid_of_runs import join

    folder = sweep_folder(Path(path))
    jobs, names = _jobs(folder)
    values = {name: list(dict.fromkeys(job.words.get(name, "") for job in jobs)) for name in names}
    shape = tuple(len(texts) for texts in values.values())
    if math.prod(shape) > SPARSEST * len(jobs):
        raise RunError(f"{folder}: {len(jobs)} runs do not make a grid over {', '.join(names)}; open them one by one")
    places: dict[tuple[int, ...], _Job] = {}
    for job in jobs:
        place = tuple(texts.index(job.words.get(name, "")) for name, texts in values.items())
        if place in places:
            raise RunError(f"{folder}: two runs have the same parameters ({places[place].folder} and {job.folder})")
        places[place] = job
    coordinates = {name: _typed([(text, _value(name, jobs, text)) for text in texts]) for name, texts in values.items()}
    runs = {place: run for place, job in places.items() if (run := _opened(job)) is not None}
    status = np.full(shape, "missing", dtype="<U11")
    where = np.full(shape, "", dtype=object)
    for place, job in places.items():
        status[place] = job.status
        where[place] = "" if job.folder is None else str(job.folder.relative_to(folder))
    sweep = join(runs, coordinates, {"status": status, "folder": where.astype(np.str_)})
    sweep.attrs[SWEEP_FOLDER] = str(folder.resolve())
    return sweep


def sweep_runs(path: Path) -> list[tuple[dict[str, str], Path | None]]:
    """Return for every job of a multirun its values of what was swept, as texts, and its folder, None if it has none.

    Raises RunError if the folder is not a multirun.
    """
    jobs, names = _jobs(sweep_folder(path))
    return [({name: job.words.get(name, "") for name in names}, job.folder) for job in jobs]


def sweep_folder(path: Path) -> Path:
    """Return the folder of a multirun, given the folder or its multirun.yaml; raises RunError if it is not one."""
    folder = path.parent if path.name == RECORD else path
    if (folder / "run.nc").exists():
        raise RunError(f"{path}: is a single run, not a multirun")
    if not is_sweep(folder):
        raise RunError(f"{path}: holds no multirun (expected its folder, with a {RECORD} and folders of runs)")
    return folder


@dataclass(frozen=True)
class Requested:
    """The request of a multirun as its file has it, and where its command was given."""

    task: tuple[str, ...]
    of_hydra: tuple[str, ...]
    name: str
    more: Path | None
    working_folder: Path | None

    def words(self, folder: Path) -> list[str]:
        """Return the words of ``dafw run`` that ask for the same jobs in the folder of the multirun."""
        from dafw.core.composition import quoted_override  # here, because it loads Hydra

        own = [word for word in self.of_hydra if not word.startswith(SET_BY_DAFW)]
        more = ["--config-dir", str(self.more)] if self.more else []
        place = quoted_override("hydra.sweep.dir", str(folder))
        return ["-m", "--config-name", self.name, *more, *self.task, *own, place]


def requested(folder: Path) -> Requested:
    """Return the request of a multirun; raises RunError if its file cannot be read."""
    import yaml

    file = folder / RECORD
    try:
        told = yaml.safe_load(file.read_text(encoding="utf-8"))["hydra"]
        sources = told["runtime"]["config_sources"]
        more = [Path(one["path"]) for one in sources if one["provider"] == "command-line"]
        here = Path(told["runtime"]["cwd"])
        return Requested(
            tuple(map(str, told["overrides"]["task"])),
            tuple(map(str, told["overrides"]["hydra"])),
            str(told["job"]["config_name"]),
            more[0] if more else None,
            here if here.is_dir() else None,
        )
    except (OSError, UnicodeError, yaml.YAMLError, LookupError, TypeError) as error:
        raise RunError(f"{file}: cannot be read ({' '.join(str(error).split())})") from error


def is_sweep(folder: Path) -> bool:
    """Return whether a folder is that of a multirun."""
    return (folder / RECORD).is_file()


def run_folders(folder: Path) -> Iterator[Path]:
    """Yield the folders of the jobs that have begun, in the order of their names."""
    for overrides in sorted(folder.rglob(".hydra/overrides.yaml")):
        yield overrides.parent.parent


@dataclass(frozen=True)
class _Job:
    """One job of a multirun: its overrides by name, its typed values, and its folder if it has begun."""

    words: Mapping[str, str]
    values: Mapping[str, Any]
    folder: Path | None

    @property
    def status(self) -> str:
        """How it ended."""
        summary = self.folder / "summary.json" if self.folder else None
        if summary is None or not summary.exists():
            return "missing"
        try:
            return str(json.loads(summary.read_text(encoding="utf-8"))["status"])
        except (OSError, ValueError, LookupError):
            return "failed"


def _jobs(folder: Path) -> tuple[list[_Job], list[str]]:
    """Return the jobs that were requested or have begun, and the names of the parameters in which they differ."""
    from dafw.core.composition import single_runs

    asked = _texts(folder / RECORD, "hydra", "overrides", "task")
    jobs = {_key(job): job for job in (_job(words, None) for words in single_runs(asked))} if asked else {}
    for run in run_folders(folder):
        job = _job(_texts(run / ".hydra" / "overrides.yaml"), run)
        if (known := jobs.get(_key(job))) is not None and known.folder is not None:
            raise RunError(f"{folder}: two runs have the same parameters ({known.folder} and {run})")
        jobs[_key(job)] = job
    swept = [override.key_or_group for override in _parsed(asked) if override.is_sweep_override()]
    for name in dict.fromkeys(name for job in jobs.values() for name in job.words):
        if len({job.words.get(name) for job in jobs.values()}) > 1 and name not in swept:
            swept.append(name)
    return list(jobs.values()), swept


def _key(job: _Job) -> tuple[tuple[str, str], ...]:
    return tuple(sorted(job.words.items()))


def _job(words: Sequence[str], folder: Path | None) -> _Job:
    parsed = _parsed(words)
    texts = {override.key_or_group: override.get_value_element_as_str() for override in parsed}
    return _Job(texts, {override.key_or_group: override.value() for override in parsed}, folder)


def _parsed(words: Sequence[str]) -> list[Any]:
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    try:
        return list(OverridesParser.create().parse_overrides(list(words)))
    except HydraException as error:
        raise RunError(f"overrides of a run that cannot be read: {' '.join(str(error).split())}") from error


def _texts(file: Path, *keys: str) -> list[str]:
    """Return a list of texts in a YAML file, under nested keys; empty if the file or the key does not exist."""
    import yaml

    try:
        found: Any = yaml.safe_load(file.read_text(encoding="utf-8")) if file.is_file() else []
        for key in keys:
            found = found[key]
    except (OSError, UnicodeError, yaml.YAMLError, LookupError, TypeError):
        return []
    return [str(text) for text in found] if isinstance(found, list) else []


def _value(name: str, jobs: Sequence[_Job], text: str) -> Any:
    return next(job.values.get(name) for job in jobs if job.words.get(name, "") == text)


def _typed(values: Sequence[tuple[str, Any]]) -> np.ndarray:
    """Return the values of a parameter as bool, int or float if all have that type, otherwise as written."""
    kinds = {type(value) for _, value in values}
    for accepted, dtype in (({bool}, np.bool_), ({int}, np.int64), ({int, float}, np.float64)):
        if kinds <= accepted:
            return np.array([value for _, value in values], dtype=dtype)
    return np.array([value if isinstance(value, str) else text for text, value in values], dtype=np.str_)


def _opened(job: _Job) -> xarray.Dataset | None:
    """Open a run lazily; return None if there is no file that can be read."""
    try:
        return None if job.folder is None else open_run(job.folder).chunk()
    except DafwError:
        return None  # its status says how it ended
