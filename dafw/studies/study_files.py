"""Study files: which configurations a study compares, and on which seeds.

A study file is ``study/NAME.yaml`` in a folder that Hydra searches: dafw's own ``conf``, that of an installed package
of plugins, or a folder given by ``--config-dir``. docs/studies.md describes its entries.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import yaml
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dafw.core.composition import explained, study_hydra
from dafw.core.errors import ConfigurationError
from dafw.core.options import build, option

GROUP = "study"
NAME = re.compile(r"\w[\w.-]{0,99}")
CONFIGURATION = re.compile(r"[\w=+][\w=+.,-]{0,119}")
"""What a configuration may be called: its name is that of a folder."""
LIGHT = ("pictures=false", "record.fields=ends")
"""Overrides of every run before those of the study file: hundreds of runs must not fill the disk."""
SEEDS = re.compile(r"(\d+)(?:-(\d+))?")
MOST_SEEDS = 100_000
LARGEST_SEED = 2**63 - 1


@dataclass(frozen=True)
class Configuration:
    """One of the configurations that a study compares: a name, its overrides, and its place on the axes."""

    name: str
    overrides: tuple[str, ...]
    place: Mapping[str, str] = field(default_factory=dict)


@dataclass
class StudyFile:
    """The entries of a study file."""

    title: str = option("", "what the study is about, in one line")
    overrides: list[str] = option([], "overrides of all configurations, as dafw run takes them")
    configurations: dict[str, list[str]] = option({}, "overrides of each configuration, by its name")
    axes: dict[str, Any] = option({}, "values of an override, or lists of overrides by name; all are combined")
    seeds: Any = option("0-9", "seeds: a range such as 100-199, or a list of numbers and ranges")
    floor: Any = option(
        False, "true: find the smallest ERR of constant parameters; or a list of overrides under which it is searched"
    )
    success: float = option(50.0, "a run succeeds if its ERR at the end is below this, in per cent", above=0.0)


@dataclass(frozen=True)
class ManyRuns:
    """A study file's request: its configurations, each to be run on every seed.

    ``floor``: overrides under which the floor of each configuration is searched for; None: it is not.
    """

    name: str
    title: str
    configurations: tuple[Configuration, ...]
    seeds: tuple[int, ...]
    success: float
    floor: tuple[str, ...] | None = None


def load_study(name: str, more: Path | None = None, overrides: Sequence[str] = ()) -> ManyRuns:
    """Read a study file; ``overrides`` are added to those of every configuration, ``more`` is a folder to search first.

    Raises ConfigurationError if there is no such file, or for an entry that is not accepted.
    """
    loader, place = study_hydra(more).config_loader, f"{GROUP}/{name}"
    repository = loader.repository  # type: ignore[attr-defined]  # it is dafw's own StudyLoader, which has one
    try:
        found = repository.load_config(place) if NAME.fullmatch(name) else None
        if found is None:
            there_are = ", ".join(study_names(more)) or "none"
            raise ConfigurationError(f"there is no study '{name}' (there are: {there_are})")
        entries: Any = OmegaConf.to_container(found.config, resolve=True)
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigurationError(f"study '{name}': {explained(error)}") from error
    except yaml.YAMLError as error:
        raise ConfigurationError(f"study '{name}': no YAML ({' '.join(str(error).split())})") from error
    if found.defaults_list:
        raise ConfigurationError(f"study '{name}': a study file has no defaults list; its experiments have")
    return study_of(name, entries, overrides)


def study_of(name: str, entries: Any, overrides: Sequence[str] = ()) -> ManyRuns:
    """Return the study that the entries of a file describe; raises ConfigurationError, which names the study."""
    if not isinstance(entries, Mapping):
        raise ConfigurationError(f"study '{name}': expected a mapping, got {entries!r}")
    where = f"study '{name}'"
    file = build(StudyFile, entries, where)
    return ManyRuns(
        name=name,
        title=file.title,
        configurations=_configurations(file, overrides, where),
        seeds=parse_seeds(file.seeds, f"{where}, seeds"),
        success=file.success,
        floor=_floor(file.floor, where),
    )


def study_names(more: Path | None = None) -> list[str]:
    """Return the names of all study files that can be found."""
    return sorted(study_hydra(more).config_loader.get_group_options(GROUP))


def parse_seeds(given: Any, where: str) -> tuple[int, ...]:
    """Return seeds from a number, a text such as ``3,5,100-199``, or a list of these; raises ConfigurationError."""
    seeds: list[int] = []
    for part in given if isinstance(given, list | tuple) else str(given).split(","):
        found = SEEDS.fullmatch(str(part).strip())
        first, last = (int(found[1]), int(found[2] or found[1])) if found and not isinstance(part, bool) else (1, 0)
        if not first <= last <= LARGEST_SEED:
            raise ConfigurationError(f"{where}: expected numbers and ranges such as 3,5,100-199, got {given!r}")
        if len(seeds) + last - first >= MOST_SEEDS:
            raise ConfigurationError(f"{where}: at most {MOST_SEEDS} seeds, got {given!r}")
        seeds += range(first, last + 1)
    if len(set(seeds)) < len(seeds):
        raise ConfigurationError(f"{where}: the same seed twice in {given!r}")
    if not seeds:
        raise ConfigurationError(f"{where}: expected one seed or more, got {given!r}")
    return tuple(seeds)


def _configurations(file: StudyFile, more: Sequence[str], where: str) -> tuple[Configuration, ...]:
    """Return every configuration of a study file combined with every place on its axes."""
    axes = {name: _axis(name, values, where) for name, values in file.axes.items()}
    found: dict[str, Configuration] = {}
    for base, words in (file.configurations or {"": []}).items():
        for choice in product(*(axis.items() for axis in axes.values())):
            place = dict(zip(axes, (label for label, _ in choice), strict=True))
            parts = [*([base] if base else []), *(f"{axis}={label}" for axis, label in place.items())]
            name = ",".join(parts) or "all"
            if not CONFIGURATION.fullmatch(name):
                raise ConfigurationError(
                    f"{where}: a configuration must be named by letters, digits and _ . , = + - (it names a folder), "
                    f"got '{name}'; an axis may be a mapping of names to lists of overrides"
                )
            if name in found:
                raise ConfigurationError(f"{where}: two configurations are called '{name}'")
            chosen = [word for _, listed in choice for word in listed]
            overrides = (*LIGHT, *file.overrides, *words, *chosen, *more)
            for word in overrides:
                if re.match(r"[+~]*seed\b", word):
                    raise ConfigurationError(f"{where}: '{word}': the seeds stand under seeds, or in --seeds")
            found[name] = Configuration(name, overrides, place)
    return tuple(found.values())


def _floor(given: Any, where: str) -> tuple[str, ...] | None:
    """Return the overrides under which floors are searched for, None if they are not."""
    if isinstance(given, bool):
        return () if given else None
    if not given or not _are_texts(given):
        raise ConfigurationError(f"{where}: floor must be true, false or a list of overrides, got {given!r}")
    return tuple(given)


def _axis(name: str, values: Any, where: str) -> dict[str, list[str]]:
    """Return the overrides of each place on an axis, by their label."""
    if isinstance(values, dict) and values and all(_are_texts(words) for words in values.values()):
        return {str(label): list(words) for label, words in values.items()}
    if isinstance(values, list) and values and not any(isinstance(value, list | dict | None) for value in values):
        texts = [_written(value) for value in values]
        if len(set(texts)) < len(texts):
            raise ConfigurationError(f"{where}: axis '{name}' has the same value twice: {values!r}")
        return {text: [f"{name}={text}"] for text in texts}
    raise ConfigurationError(
        f"{where}: axis '{name}' must be a list of values, or a mapping of names to lists of overrides, got {values!r}"
    )


def _are_texts(words: Any) -> bool:
    return isinstance(words, list) and all(isinstance(word, str) for word in words)


def _written(value: Any) -> str:
    """Return a value as an override has it."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def runs_of(study: ManyRuns) -> Iterator[tuple[Configuration, int]]:
    """Yield all runs, seed by seed, so that a study that is stopped has as many runs of each configuration."""
    for seed in study.seeds:
        for configuration in study.configurations:
            yield configuration, seed
