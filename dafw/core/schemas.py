"""The options of plugins in Hydra's store, made when Hydra first asks for them.

A study has six plugins of some fifty. To import and describe all of them took longer than to compose the study.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from hydra.core.config_store import ConfigNode, ConfigStore
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dafw.core.errors import PluginError
from dafw.core.experiment import StudyOptions
from dafw.core.options import schema
from dafw.core.registry import KINDS, registry

ENDING = ".yaml"
"""Hydra names the entries of its store like files."""


class PluginSchemas(dict[str, ConfigNode]):
    """The entries of one kind, ``NAME.yaml``, in Hydra's store: those that were asked for, others when they are.

    A plugin that cannot be imported or composed has no entry: asked for by name, ``compose`` says why.
    """

    def __init__(self, kind: str) -> None:
        super().__init__()
        self.kind = kind

    def __contains__(self, entry: object) -> bool:
        """Return whether there is an entry, after making it if its plugin is registered."""
        if not super().__contains__(entry):
            for registered in registry().plugins():
                if registered.spec.kind == self.kind and f"{registered.spec.name}{ENDING}" == entry:
                    self._make(registered.spec.name, registered.package)
        return super().__contains__(entry)

    def _make(self, name: str, package: str) -> None:
        with suppress(PluginError, OmegaConfBaseException):
            node = OmegaConf.structured(registry().schema(self.kind, name))
            entry = f"{name}{ENDING}"
            self[entry] = ConfigNode(name=entry, node=node, group=self.kind, package=None, provider=package)

    def keys(self) -> Any:
        """Return the names of all entries, which makes them."""
        for name in registry().names(self.kind):
            _ = f"{name}{ENDING}" in self
        return super().keys()


def register_schemas() -> None:
    """Tell Hydra about the study and every plugin, unless its store, one a process, knows them."""
    store = ConfigStore.instance()
    if f"study{ENDING}" not in store.repo:
        store.store(name="study", node=schema(StudyOptions))
    for kind in KINDS:
        if not isinstance(store.repo.get(kind), PluginSchemas):
            made = PluginSchemas(kind)
            made.update(store.repo.get(kind, {}))
            store.repo[kind] = made
