"""The interfaces of plugins: Model, Observer, Policy, Filter, and the source of Readings.

Each interface has two methods for the same task. The author of a plugin writes the one that computes (``step``,
``operator``, ``decide``, ``analyse``, ``take``). The framework calls the one on the base class (``forecast``, ``look``,
``route``, ``update``, ``collect``). It passes read-only arrays to the author's method, checks the result (shape,
finiteness, space) and names the plugin in its error.

What a plugin must remember is passed explicitly. A plugin that remembers overrides ``initial_memory`` and the method
whose name ends in ``_with_memory``; all others need neither. Random numbers come from the generator that is passed in.
A filter that looks back and a policy that looks ahead define another method (``analyse_window``, ``plan``), which is
given the past or the outlook, and a way to run the model again.
"""

from __future__ import annotations

from dafw.core.interfaces.filter import Filter
from dafw.core.interfaces.model import Model
from dafw.core.interfaces.observer import Observer
from dafw.core.interfaces.policy import Policy
from dafw.core.interfaces.readings import Readings

__all__ = ["Filter", "Model", "Observer", "Policy", "Readings"]
