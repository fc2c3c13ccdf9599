"""Hydra's configuration loader, which keeps an experiment's options with the plugin that they were written for.

An experiment chooses ``policy: enie2d`` and says ``policy: {sectors: 8}``. Where the policy is exchanged, on the
command line or by an experiment that builds on this one, ``sectors`` leaves with ``enie2d``: the other policy starts
from its own defaults. So for each file of a composition and each kind, this module finds the plugin that the file's
options are for:

- the plugin that the file chooses itself, or that a file it includes chooses;
- otherwise the plugin that the including file's options are for, and so on up to the primary configuration.

A file's options for a kind are used only if the study ends up with that plugin, by whatever preset. ``truth`` and
``free`` hold options of a model: of the model that they name, otherwise of the study's model.
"""

from __future__ import annotations

import copy
import typing
from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from pathlib import PurePosixPath
from typing import Any

from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.config_repository import CachingConfigRepository, IConfigRepository
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.default_element import GroupDefault, InputDefault, ResultDefault
from hydra.core.override_parser.types import ChoiceSweep, Override, OverrideType, ValueType
from hydra.plugins.config_source import ConfigResult
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict

from dafw.core.config_sources import Kept, KeptSources
from dafw.core.registry import KINDS

ROLES = ("truth", "free")
"""Keys of a study that hold options of a model beside the study's own."""

KEPT = 100
"""How many compositions are kept, of about a megabyte each; a multirun may have thousands of jobs."""

_TOGETHER = Kept(50)
"""What the files of a study are together, before the command line changes them."""


class StudyLoader(ConfigLoaderImpl):
    """Composes a study. Hydra calls it for everything it does: a run, the jobs of a multirun, ``--cfg``."""

    _made: dict[object, DictConfig]
    _multirun = False
    _appended: Sequence[str] = ()
    _named_roles: Mapping[str, str]
    _foreign: Mapping[str, set[str]]

    def __init__(self, config_search_path: ConfigSearchPath) -> None:
        super().__init__(config_search_path)
        self.repository = KeptSources(config_search_path)
        self._made = {}

    def __getstate__(self) -> dict[str, Any]:
        """Leave what is kept: launchers send the loader with each job to the process that runs it."""
        return {**vars(self), "_made": {}}

    def load_configuration(
        self,
        config_name: str | None,
        overrides: list[str],
        run_mode: RunMode,
        from_shell: bool = True,
        validate_sweep_overrides: bool = True,
    ) -> DictConfig:
        """Compose a configuration; raises Hydra's and OmegaConf's exceptions.

        The same request is not composed again: ``dafw run`` checks a study, then Hydra runs it; a multirun asks for all
        jobs before the first, then for each. Kept are the first ``KEPT`` and the last.
        """
        asked = (config_name, tuple(overrides), run_mode, validate_sweep_overrides)
        if asked not in self._made:
            one = copy.copy(self)  # state found while composing must not leak into the next composition
            one._multirun = run_mode == RunMode.MULTIRUN
            arguments = (config_name, overrides, run_mode, from_shell, validate_sweep_overrides)
            composed = super(StudyLoader, one).load_configuration(*arguments)
            if len(self._made) > KEPT:
                self._made.popitem()
            self._made[asked] = composed
        return copy.deepcopy(self._made[asked])

    def _parse_overrides_and_create_caching_repo(
        self, config_name: str | None, overrides: list[str]
    ) -> tuple[list[Override], CachingConfigRepository]:
        parsed, repo = super()._parse_overrides_and_create_caching_repo(config_name, overrides)
        for override in parsed:
            # Before a multirun starts, Hydra composes once with all its values together: use the first job's values.
            swept = override.value() if self._multirun and repo.group_exists(override.key_or_group) else None
            if isinstance(swept, ChoiceSweep) and swept.list:
                override.value_type, override._value = ValueType.ELEMENT, swept.list[0]
        fixed = [override for override in parsed if not override.is_sweep_override()]
        self._appended = [f"{add.key_or_group}/{add.value()}" for add in fixed if add.is_add()]
        self._named_roles = {
            role: str(change.value()) for change in fixed for role in ROLES if change.key_or_group == f"{role}.name"
        }
        for override in parsed:  # accept `+` also before a key that exists
            if override.is_add() and not repo.group_exists(override.key_or_group):
                override.type = OverrideType.FORCE_ADD
        return parsed, repo

    def _compose_config_from_defaults_list(self, defaults: list[ResultDefault], repo: IConfigRepository) -> DictConfig:
        """Return what the chosen files are together; it is kept, because the runs of a study differ in less."""
        files = [repo.load_config(str(default.config_path)) for default in defaults]
        chosen = tuple((one.config_path, one.parent, one.package, one.is_self, one.primary) for one in defaults)
        asked = (chosen, tuple(self._appended), tuple(sorted(self._named_roles.items())))
        together: DictConfig = _TOGETHER.copy_of(
            asked, [file and file.config for file in files], lambda: self._together(defaults, repo)
        )
        return together

    def _together(self, defaults: list[ResultDefault], repo: IConfigRepository) -> DictConfig:
        self._foreign = _Files(defaults, repo, self._appended).foreign(self._named_roles)
        config = super()._compose_config_from_defaults_list(defaults, repo)
        for key, node in config.items_ex(resolve=False):
            if key != "hydra":
                _open_mappings(node)
        return config

    def _load_single_config(self, default: ResultDefault, repo: IConfigRepository) -> ConfigResult:
        loaded = super()._load_single_config(default, repo)
        foreign = self._foreign.get(str(default.config_path), set())
        # What is embedded in a package is a copy already.
        kept = repo.load_config(str(default.config_path))
        if foreign or (kept is not None and loaded.config is kept.config):
            # Its nodes become nodes of the study, where they are changed.
            loaded = replace(loaded, config=copy.deepcopy(loaded.config))
        if foreign and isinstance(loaded.config, DictConfig):
            with open_dict(loaded.config):
                for key in foreign:
                    loaded.config.pop(key)
        return loaded


def _open_mappings(node: Any) -> None:
    """Let options that are mappings, and ``truth`` and ``free``, accept new keys."""
    if not isinstance(node, DictConfig) or node._is_interpolation():
        return
    made_of, declared = OmegaConf.get_type(node), typing.get_origin(node._metadata.ref_type)
    if made_of is dict or (made_of is None and declared is dict):  # None: must be given, or null
        OmegaConf.set_struct(node, False)
    elif not node._is_none() and not node._is_missing():
        for _, entry in node.items_ex(resolve=False):
            _open_mappings(entry)


class _Files:
    """The files of one composition, and the plugins that their options are for."""

    def __init__(self, defaults: Sequence[ResultDefault], repo: IConfigRepository, appended: Container[str]) -> None:
        self.repo, self.appended = repo, appended
        self.parents = {str(default.config_path): str(default.parent) for default in defaults}
        self.packages = {str(default.config_path): default.package for default in defaults}

    def foreign(self, named_roles: Mapping[str, str]) -> dict[str, set[str]]:
        """Return for each file the keys whose options are for a plugin that this study does not use.

        ``named_roles`` holds the models of the truth and the free run that the command line names.
        """
        final: dict[str, str] = {}
        for file, package in self.packages.items():
            if package in KINDS and "name" in self._body(file):
                final[package] = str(self._body(file)["name"])
        bodies = {file: self._body(file) for file, package in self.packages.items() if package == ""}
        # not the study's own schema, in which all keys are
        whole = {file: body for file, body in bodies.items() if OmegaConf.get_type(body) is dict}
        for role in ROLES:
            named = [name for file in whole if (name := self._named(file, role))]
            final[role] = named_roles.get(role) or (named[-1] if named else final.get("model", ""))
        found: dict[str, set[str]] = {}
        for file, body in whole.items():
            for key in map(str, body.keys() & final.keys()):
                if (meant := self._meant(file, key)) and meant != final[key]:
                    found.setdefault(file, set()).add(key)
        return found

    def _body(self, file: str) -> DictConfig:
        loaded = self.repo.load_config(file)
        return loaded.config if loaded is not None and isinstance(loaded.config, DictConfig) else DictConfig({})

    def _meant(self, file: str, key: str) -> str | None:
        """Return the plugin that a file's options are for; None if that cannot be determined."""
        while file in self.parents:
            found = self._choice(file, key) or (self._choice(file, "model") if key in ROLES else None)
            if found or file in self.appended:
                return found
            file = self.parents[file]
        return None

    def _choice(self, file: str, key: str) -> str | None:
        """Return the plugin that a file chooses, itself or through the files it includes; the last choice counts."""
        if key in ROLES and (name := self._named(file, key)):
            return name
        loaded = self.repo.load_config(file)
        entries = {} if loaded is None else dict(_entries(file, loaded.defaults_list or [], key))
        if True in entries:
            return self._plugin(key, entries[True])
        for child in reversed([path for path, parent in self.parents.items() if parent == file]):
            if name := self._choice(child, key):
                return name
        return self._plugin(key, entries[False]) if False in entries else None

    def _named(self, file: str, role: str) -> str | None:
        options = self._body(file).get(role)
        return str(options["name"]) if isinstance(options, Mapping) and "name" in options else None

    def _plugin(self, kind: str, choice: str) -> str:
        """Return the name of the plugin behind a choice, which may be a preset of it."""
        path = f"{kind}/{choice}"
        loaded = self.repo.load_config(path)
        if loaded is None or "name" in loaded.config:
            return choice if loaded is None else str(loaded.config["name"])
        for entry in reversed(loaded.defaults_list or []):
            if not entry.is_self() and not isinstance(entry, GroupDefault):
                return self._plugin(kind, str(entry.get_name()))
        return choice


def _entries(file: str, defaults: Sequence[InputDefault], kind: str) -> list[tuple[bool, str]]:
    """Return what a file's own defaults list chooses for a kind: whether it overrides, and the choice."""
    folder = PurePosixPath("/", file).parent
    return [
        (bool(entry.override), entry.value)
        for entry in defaults
        if isinstance(entry, GroupDefault) and folder / str(entry.group) == PurePosixPath("/", kind)
        if isinstance(entry.value, str) and "${" not in entry.value
    ]
