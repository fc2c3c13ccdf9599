"""Where configurations are looked up, and what is kept of them in a process: most of composing was doing it again."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from operator import is_not
from pathlib import Path
from typing import Any

from hydra._internal.config_repository import ConfigRepository
from hydra.core.config_store import ConfigStore
from hydra.core.object_type import ObjectType
from hydra.plugins.config_source import ConfigResult, ConfigSource


class Kept:
    """Results by what was asked, at most ``most`` of them, used again only if they were made of the same objects."""

    def __init__(self, most: int) -> None:
        self.most = most
        self._results: dict[object, tuple[Sequence[object], Any]] = {}

    def get(self, asked: object, made_of: Sequence[object], make: Callable[[], Any]) -> Any:
        """Return the kept result, or make it."""
        before, result = self._results.get(asked, (None, None))
        if before is None or len(before) != len(made_of) or any(map(is_not, before, made_of)):
            if len(self._results) >= self.most:
                self._results.clear()
            result = make()
            self._results[asked] = (made_of, result)
        return result

    def copy_of(self, asked: object, made_of: Sequence[object], make: Callable[[], Any]) -> Any:
        """Return a copy of the kept result, which may be changed."""
        return copy.deepcopy(self.get(asked, made_of, make))


_LOADED = Kept(500)
"""Contents of files and of Hydra's store."""


class KeptSources(ConfigRepository):
    """Where configurations are looked up. A copy shares the sources, which nobody changes; its list is its own.

    Hydra makes a copy for each composition. To copy the options of all plugins with it would take a fifth of the time.
    """

    def __deepcopy__(self, memo: dict[int, Any]) -> KeptSources:
        one = copy.copy(self)
        one.sources = list(self.sources)
        return one

    def load_config(self, config_path: str) -> ConfigResult | None:
        """Return a configuration, whose content is not to be changed; None if there is none.

        It is kept until its file, or its entry in Hydra's store, is another.
        """
        source = self._find_object_source(config_path, ObjectType.CONFIG)
        if source is None or source.scheme() not in ("structured", "file", "pkg"):
            found: ConfigResult | None = super().load_config(config_path)
            return found
        asked, made_of = _identity(source, source._normalize_file_name(config_path))
        kept: ConfigResult = _LOADED.get(asked, made_of, lambda: super(KeptSources, self).load_config(config_path))
        return copy.copy(kept)  # Hydra changes its attributes, not their values


def _identity(source: ConfigSource, name: str) -> tuple[object, Sequence[object]]:
    """Return what tells a configuration from others, and the objects of which it is made."""
    where = (source.scheme(), source.provider, source.path, name)
    if source.scheme() == "structured":
        return where, [ConfigStore.instance()._load(name).node]
    if source.scheme() == "file":
        state = Path(source.path, name).stat()
        return (*where, state.st_mtime_ns, state.st_size, state.st_ino), []
    return where, []  # part of an installed package
