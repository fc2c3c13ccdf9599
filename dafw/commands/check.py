"""``dafw check``: the conformance kit on registered plugins, as a table."""

from __future__ import annotations

from collections.abc import Sequence

from dafw.commands.parser import Parser
from dafw.core.errors import DafwError
from dafw.core.hookspecs import PluginSpec
from dafw.core.registry import registry


def check_command(words: Sequence[str]) -> int:
    """Print a line for each check of the named plugins, or of all; return 0 if no plugin needs a fix, else 1.

    Raises PluginError for a name that no plugin has.
    """
    parser = Parser(prog="dafw check", description="Hold plugins to what their interface promises.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="a plugin's name")
    parser.add_argument("--all", action="store_true", help="every plugin that is installed")
    asked = parser.parse_args(words)
    if bool(asked.names) == asked.all:
        parser.error("expected either names of plugins or --all")
    chosen = registry().plugins() if asked.all else [found for name in asked.names for found in registry().named(name)]
    wrong = sum(_check(registered.spec) for registered in chosen)
    for problem in registry().problems if asked.all else ():
        print(f"package {problem.package}: {problem.message}")
        wrong += 1
    print(f"{len(chosen)} plugins checked, " + (f"{wrong} things to mend" if wrong else "nothing to mend"))
    return 1 if wrong else 0


def _check(spec: PluginSpec) -> int:
    """Print the checks of one plugin; return how many need a fix."""
    from dafw.authoring.checks import PASSED, factory_of, made
    from dafw.authoring.kit import run_checks

    label = f"{spec.kind} '{spec.name}'"
    try:
        factory = factory_of(spec)
        made(spec.kind, factory)
    except Exception as error:  # whatever its author's code raises
        message = str(error) if isinstance(error, DafwError) else f"{type(error).__name__}: {error}"
        print(f"{label:<28} cannot be made: {' '.join(message.split())}")
        return 1
    wrong = 0
    for outcome in run_checks(spec.kind, factory):
        detail = "" if outcome.status == PASSED else outcome.detail
        print(f"{label:<28} {outcome.check.name:<20} {outcome.status:<17} {detail}".rstrip(), flush=True)
        wrong += not outcome.ok
    return wrong
