"""The interfaces of plugins: Model, Observer, Policy, Filter, and the source of Readings.

An author's verb computes (``step``, ``operator``, ``decide``, ``analyse``, ``take``); the user's verb on the base class
(``forecast``, ``look``, ``route``, ``update``, ``collect``) hands it read-only arrays, checks what comes back (shape,
finiteness, space) and names the plugin in its error.

Whatever a plugin must remember is explicit. A plugin that remembers overrides ``initial_memory`` and the verb whose
name ends in ``_with_memory``; one that does not never hears of it. Random numbers come from the generator handed in.
A filter that looks back and a policy that looks ahead define another verb (``analyse_window``, ``plan``), which is
handed the past or the outlook, and the means to run the model again.
"""

from __future__ import annotations

from dafw.core.interfaces.filter import Filter
from dafw.core.interfaces.model import Model
from dafw.core.interfaces.observer import Observer
from dafw.core.interfaces.policy import Policy
from dafw.core.interfaces.readings import Readings

__all__ = ["Filter", "Model", "Observer", "Policy", "Readings"]
