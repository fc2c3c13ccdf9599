"""``dafw check``: the conformance kit on registered plugins, as a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dafw.core.errors import DafwError
from dafw.core.hookspecs import PluginSpec
from dafw.core.registry import registry
from dafw.testing.checks import PASSED, Factory, run_checks


def check_command(names: Sequence[str], *, everything: bool) -> int:
    """Print a line for each check of the named plugins, or of all; return 0 where none needs mending, else 1.

    Raises PluginError for a name that nobody has.
    """
    chosen = registry().plugins() if everything else [found for name in names for found in registry().named(name)]
    wrong = sum(_check(registered.spec) for registered in chosen)
    for problem in registry().problems if everything else ():
        print(f"package {problem.package}: {problem.message}")
        wrong += 1
    print(f"{len(chosen)} plugins checked, " + (f"{wrong} things to mend" if wrong else "nothing to mend"))
    return 1 if wrong else 0


def factory_of(spec: PluginSpec) -> Factory:
    """Return what makes fresh plugins with the options that they want to be checked under; raises PluginError."""
    options = registry().plugin_class(spec.kind, spec.name).check_options()

    def make() -> Any:
        return registry().create(spec.kind, {"name": spec.name, **options})

    return make


def _check(spec: PluginSpec) -> int:
    """Print the checks of one plugin; return how many need mending."""
    label = f"{spec.kind} '{spec.name}'"
    try:
        outcomes = run_checks(spec.kind, factory_of(spec))
        wrong = 0
        for outcome in outcomes:
            detail = "" if outcome.status == PASSED else outcome.detail
            print(f"{label:<28} {outcome.check.name:<20} {outcome.status:<17} {detail}".rstrip(), flush=True)
            wrong += not outcome.ok
    except Exception as error:  # a plugin that cannot even be made
        message = str(error) if isinstance(error, DafwError) else f"{type(error).__name__}: {error}"
        print(f"{label:<28} cannot be made: {' '.join(message.split())}")
        return 1
    return wrong
