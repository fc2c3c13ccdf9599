"""The one hook: a package tells dafw which plugins it has. Entry-point group ``dafw``.

>>> @hookimpl
... def dafw_plugins():
...     return [PluginSpec("filter", "nudging", "acme.nudging:Nudging", "pulls towards the readings")]
>>> dafw_plugins()[0].name
'nudging'
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import pluggy

hookspec = pluggy.HookspecMarker("dafw")
hookimpl = pluggy.HookimplMarker("dafw")


@dataclass(frozen=True)
class PluginSpec:
    """One plugin: its kind (model, observer, policy, filter, readings, executor), its name and where its class is.

    ``target`` is ``package.module:Class``. It is imported when its options or the plugin itself are asked for, so
    that registering costs nothing. ``summary`` is one line for ``dafw plugins``.
    """

    kind: str
    name: str
    target: str
    summary: str = ""


@hookspec
def dafw_plugins() -> Iterable[PluginSpec]:
    """Return the plugins of this package."""
    raise NotImplementedError
