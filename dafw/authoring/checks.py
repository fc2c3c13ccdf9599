"""Checks of plugins: their registration, how they are run, and their outcomes.

A check is a function that takes a factory of fresh plugins and raises an error if the plugin does not do what its
interface promises. The function's name is the name of the check, and its docstring says what is checked and why;
docs/conformance.md has a section for each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import wraps
from inspect import unwrap
from time import perf_counter
from typing import Any

from threadpoolctl import threadpool_limits

from dafw.core.errors import ComputationError
from dafw.core.hookspecs import PluginSpec
from dafw.core.plugin import Plugin
from dafw.core.registry import KINDS, registry

type Factory = Callable[[], Any]

PASSED, FAILED, SKIPPED = "passed", "failed", "not applicable"
EXPECTED, UNEXPECTED = "expected failure", "unexpected pass"


class ConformanceError(ComputationError):
    """A plugin does not do what its interface promises; the message names plugin, check and what was found."""


class NotApplicable(Exception):  # noqa: N818  # a result of a check, not an error
    """Raised by a check that does not apply to this plugin, with the reason."""


@dataclass(frozen=True)
class Check:
    """One check of one kind of plugin."""

    kind: str
    name: str
    reason: str
    run: Callable[[Factory], None]


@dataclass(frozen=True)
class Outcome:
    """The outcome of a check: its ``status`` and, unless it passed, the reason."""

    check: Check
    status: str
    detail: str = ""
    seconds: float = 0.0

    @property
    def ok(self) -> bool:
        """Whether the plugin needs no fix."""
        return self.status in (PASSED, SKIPPED, EXPECTED)


CHECKS: dict[str, dict[str, Check]] = {kind: {} for kind in KINDS}
"""All checks by kind and name, in the order in which they run."""


def check(kind: str) -> Callable[[Callable[[Factory], None]], Callable[[Factory], None]]:
    """Register the decorated function as a check of this kind."""

    def register(function: Callable[[Factory], None]) -> Callable[[Factory], None]:
        reason = " ".join((function.__doc__ or "").split())

        @wraps(function)
        def run(factory: Factory) -> None:
            # One thread, as in studies: for the small matrices of the checks several threads are slower.
            with threadpool_limits(limits=1, user_api="blas"):
                function(factory)

        known = CHECKS[kind] | {function.__name__: Check(kind, function.__name__, reason, run)}
        CHECKS[kind] = dict(sorted(known.items(), key=lambda entry: _place(entry[1])))
        return function

    return register


def _place(one: Check) -> tuple[str, int]:
    """Return the module and the line of a check: the order of checks does not depend on what was imported first."""
    function = unwrap(one.run)
    return function.__module__, function.__code__.co_firstlineno


def made(kind: str, factory: Factory) -> Plugin:
    """Return a plugin of the factory; raises ConformanceError for another kind, or expected failures of no check."""
    plugin = factory()
    if not isinstance(plugin, Plugin) or plugin.kind != kind:
        raise ConformanceError(f"expected the factory to make a {kind}, it made a {type(plugin).__name__}")
    for name in plugin.expected_failures:
        if name not in CHECKS[kind]:
            raise ConformanceError(
                f"{plugin.label} expects the failure of '{name}', which is no check (checks: {', '.join(CHECKS[kind])})"
            )
    return plugin


def factory_of(spec: PluginSpec) -> Factory:
    """Return a factory of fresh plugins with the options of their ``check_options``; raises PluginError."""
    options = registry().plugin_class(spec.kind, spec.name).check_options()

    def make() -> Any:
        return registry().create(spec.kind, {"name": spec.name, **options})

    return make


def run_check(one: Check, factory: Factory, expected: str | None = None) -> Outcome:
    """Run one check; ``expected`` is the reason if the plugin declares that it fails, otherwise None."""
    begun = perf_counter()
    try:
        one.run(factory)
        status, detail = PASSED, ""
    except NotApplicable as reason:
        return Outcome(one, SKIPPED, str(reason), perf_counter() - begun)
    except ConformanceError as error:
        status, detail = FAILED, str(error)
    except Exception as error:  # any other error of the plugin is a finding of the check
        status, detail = FAILED, f"{type(error).__name__}: {' '.join(str(error).split())}"
    if expected is not None:
        status, detail = (EXPECTED, expected) if status == FAILED else (UNEXPECTED, f"declared to fail: {expected}")
    return Outcome(one, status, detail, perf_counter() - begun)


def run_checks(kind: str, factory: Factory) -> Iterator[Outcome]:
    """Run all checks of a kind on the plugins that ``factory()`` makes, one outcome at a time.

    Raises ConformanceError if the factory makes another kind of plugin, and the errors of the factory itself.
    """
    plugin = made(kind, factory)
    for one in CHECKS[kind].values():
        yield run_check(one, factory, plugin.expected_failures.get(one.name))


def demand(kind: str, factory: Factory) -> list[Outcome]:
    """Run all checks and return their outcomes; raises ConformanceError that names every failed one."""
    label = made(kind, factory).label
    outcomes = list(run_checks(kind, factory))
    wrong = [f"{outcome.check.name}: {outcome.status}, {outcome.detail}" for outcome in outcomes if not outcome.ok]
    if wrong:
        raise ConformanceError(f"{label} does not conform: {'; '.join(wrong)}")
    return outcomes


def require(condition: object, message: str) -> None:
    """Raise ConformanceError with the message unless the condition holds."""
    if not condition:
        raise ConformanceError(message)
