"""The registry: finds packages through the entry-point group ``dafw`` and makes plugins by kind and name.

A package that cannot be imported, misspells the hook or uses a name that is already in use does not stop the others.
It is kept as a ``Problem``, which ``dafw plugins`` lists. Asking for one of its plugins raises it as PluginError.
"""

from __future__ import annotations

import difflib
import importlib
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points, packages_distributions, version
from typing import TYPE_CHECKING, Any

import pluggy

from dafw.core import hookspecs
from dafw.core.errors import DafwError, OptionError, PluginError
from dafw.core.hookspecs import PluginSpec
from dafw.core.options import Described, build, describe, schema

if TYPE_CHECKING:
    from dafw.core.plugin import Plugin

KINDS = {
    "model": "dafw.core.interfaces:Model",
    "observer": "dafw.core.interfaces:Observer",
    "policy": "dafw.core.interfaces:Policy",
    "filter": "dafw.core.interfaces:Filter",
    "readings": "dafw.core.interfaces:Readings",
    "executor": "dafw.core.executors:Executor",
}
"""The kinds of plugins and the base class of each. As with plugins, a class is imported when it is needed: `dafw
plugins` lists names without NumPy, in about half the time."""
GROUP = "dafw"


@dataclass(frozen=True)
class Registered:
    """A plugin and the package that brought it."""

    spec: PluginSpec
    package: str


@dataclass(frozen=True)
class Problem:
    """What is wrong with a package or with one of its plugins."""

    package: str
    message: str


class Registry:
    """The plugins of all packages, by kind and name."""

    def __init__(self, packages: Iterable[EntryPoint]) -> None:
        self._manager = pluggy.PluginManager(GROUP)
        self._manager.add_hookspecs(hookspecs)
        self._plugins: dict[tuple[str, str], Registered] = {}
        self._versions: dict[str, str] = {}
        self.problems: list[Problem] = []
        # dafw's own package first, then the others by name: so no other package can take the name of a built-in.
        for entry in sorted(packages, key=lambda entry: (entry.value != "dafw.plugins", entry.name)):
            package = f"{entry.dist.name if entry.dist else entry.value} ({entry.value})"
            if entry.dist is not None:
                self._versions[entry.dist.name] = entry.dist.version
            try:
                self._add_package(entry.load(), package)
            except PluginError as error:
                self.problems.append(Problem(package, str(error)))
            except Exception as error:
                self.problems.append(Problem(package, f"cannot be imported: {type(error).__name__}: {error}"))

    def _add_package(self, module: object, package: str) -> None:
        for attribute in dir(module):
            marked = getattr(getattr(module, attribute, None), "dafw_impl", None)
            if marked and not hasattr(hookspecs, marked.get("specname") or attribute):
                raise PluginError(f"unknown hook '{attribute}' (the hook is: dafw_plugins)")
        if not hasattr(getattr(module, "dafw_plugins", None), "dafw_impl"):
            raise PluginError("defines no hook 'dafw_plugins' marked with @dafw.hookimpl")
        others = self._manager.get_plugins()
        try:
            self._manager.register(module)
        except (pluggy.PluginValidationError, ValueError) as error:
            raise PluginError(f"cannot be registered: {' '.join(str(error).split())}") from error
        for specs in self._manager.subset_hook_caller("dafw_plugins", others)():
            for spec in specs:
                self._add(spec, package)

    def _add(self, spec: PluginSpec, package: str) -> None:
        """Keep one plugin, or note why it cannot be kept."""
        if not isinstance(spec, PluginSpec):
            self.problems.append(Problem(package, f"dafw_plugins gave a {type(spec).__name__}, not a PluginSpec"))
        elif spec.kind not in KINDS:
            self.problems.append(
                Problem(package, f"plugin '{spec.name}' has the unknown kind '{spec.kind}' (kinds: {', '.join(KINDS)})")
            )
        elif (spec.kind, spec.name) in self._plugins:
            owner = self._plugins[spec.kind, spec.name].package
            self.problems.append(Problem(package, f"{spec.kind} '{spec.name}' is taken already by {owner}"))
        else:
            self._plugins[spec.kind, spec.name] = Registered(spec, package)

    def plugins(self) -> list[Registered]:
        """Return all plugins, ordered by kind and name."""
        order = list(KINDS)
        return sorted(self._plugins.values(), key=lambda r: (order.index(r.spec.kind), r.spec.name))

    def names(self, kind: str) -> list[str]:
        """Return the names of one kind."""
        return sorted(name for k, name in self._plugins if k == kind)

    def named(self, name: str) -> list[Registered]:
        """Return the plugins of this name of all kinds; raises PluginError if there is none."""
        found = [registered for registered in self.plugins() if registered.spec.name == name]
        if not found:
            known = sorted({registered.spec.name for registered in self.plugins()})
            raise PluginError(f"there is no plugin '{name}' (there are: {', '.join(known)}){self._reasons()}")
        return found

    def plugin_class(self, kind: str, name: str) -> type[Plugin]:
        """Import and return the class of a plugin; raises PluginError with the reason."""
        if (kind, name) not in self._plugins:
            raise PluginError(f"there is no {kind} '{name}' ({self._nearest(kind, name)}){self._reasons()}")
        registered = self._plugins[kind, name]
        try:
            cls = _class(registered.spec.target)
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            raise PluginError(
                f"{kind} '{name}' of {registered.package}: {registered.spec.target} cannot be imported: {reason}"
            ) from error
        if not (isinstance(cls, type) and issubclass(cls, _class(KINDS[kind]))):
            raise PluginError(f"{kind} '{name}' of {registered.package}: {registered.spec.target} is no {kind} class")
        return cls

    def _nearest(self, kind: str, name: str) -> str:
        close = difflib.get_close_matches(name, self.names(kind), n=1)
        there = f"there are: {', '.join(self.names(kind)) or 'none'}"
        return f"did you mean '{close[0]}'? {there}" if close else there

    def _reasons(self) -> str:
        return "".join(f"; package {problem.package}: {problem.message}" for problem in self.problems)

    def options(self, kind: str, name: str) -> list[Described]:
        """List the options of a plugin; raises PluginError if its class declares them wrongly."""
        try:
            return describe(self.plugin_class(kind, name))
        except OptionError as error:
            raise PluginError(f"{kind} '{name}': {error}") from error

    def schema(self, kind: str, name: str) -> type:
        """Return the dataclass type that Hydra composes for a plugin."""
        try:
            return schema(self.plugin_class(kind, name), name=name)
        except OptionError as error:
            raise PluginError(f"{kind} '{name}': {error}") from error

    def create(self, kind: str, config: Mapping[str, Any]) -> Any:
        """Make a plugin from a mapping that holds its ``name`` and options; raises PluginError, OptionError."""
        options = dict(config)
        name = options.pop("name", None)
        if not isinstance(name, str):
            raise PluginError(
                f"{'an' if kind[0] in 'aeiou' else 'a'} {kind} needs a name ({self._nearest(kind, str(name))})"
            )
        cls = self.plugin_class(kind, name)
        try:
            plugin = build(cls, options, f"{kind} '{name}'")
        except DafwError:
            raise
        except Exception as error:
            raise PluginError(f"{kind} '{name}' cannot be made: {type(error).__name__}: {error}") from error
        plugin.name = name
        return plugin

    def recipe(self, plugin: Plugin) -> dict[str, Any] | None:
        """Return the configuration from which ``create`` makes the same plugin again; None for an unregistered class.

        That is the name and the dataclass fields that ``__init__`` accepts.
        """
        name = self._registered_name(plugin)
        if name is None or not is_dataclass(plugin):
            return None
        return {"name": name, **{f.name: _plain(getattr(plugin, f.name)) for f in fields(plugin) if f.init}}

    def _registered_name(self, plugin: Plugin) -> str | None:
        of_its_kind = ((name, one) for (kind, name), one in self._plugins.items() if kind == plugin.kind)
        return next((name for name, one in of_its_kind if _loaded_class(one.spec.target) is type(plugin)), None)

    def parts(self, plugins: Mapping[str, Plugin]) -> dict[str, str]:
        """Return by role each plugin's registered name, or ``package.module:Class`` if its class is not registered."""
        return {role: self._registered_name(plugin) or _target(plugin) for role, plugin in plugins.items()}

    def versions(self, plugins: Iterable[Plugin] = ()) -> dict[str, str]:
        """Return the versions of all packages that registered something, and of those whose classes are used."""
        found = dict(self._versions)
        for plugin in plugins:
            if self._registered_name(plugin) is None:
                for name in _distributions().get(type(plugin).__module__.partition(".")[0], ()):
                    found[name] = version(name)
        return dict(sorted(found.items()))


@cache
def _distributions() -> Mapping[str, list[str]]:
    """Return the installed distributions by the packages that they brought."""
    return packages_distributions()


def _class(target: str) -> Any:
    """Import and return the class of a target ``package.module:Class``."""
    module, _, attribute = target.partition(":")
    return getattr(importlib.import_module(module), attribute)


def _loaded_class(target: str) -> Any:
    """Return the class of a target; None if its module is not imported, because then no instance of it can exist."""
    module, _, attribute = target.partition(":")
    return getattr(sys.modules.get(module), attribute, None)


def _target(plugin: Plugin) -> str:
    return f"{type(plugin).__module__}:{type(plugin).__qualname__}"


def _plain(value: Any) -> Any:
    """Return options as plain values: dataclasses become mappings, as in a configuration."""
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


@cache
def registry() -> Registry:
    """Return the registry of everything that is installed."""
    return Registry(entry_points(group=GROUP))
