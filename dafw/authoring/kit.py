"""The checks of all four kinds of plugins, and what runs them; public as ``dafw.testing``."""

from __future__ import annotations

from dafw.authoring import filter_checks, filter_kalman, model_checks, observer_checks, policy_checks
from dafw.authoring.checks import CHECKS, Check, ConformanceError, Factory, Outcome, demand, run_check, run_checks

__all__ = [
    "CHECKS",
    "Check",
    "ConformanceError",
    "Outcome",
    "check_filter",
    "check_model",
    "check_observer",
    "check_policy",
    "run_check",
    "run_checks",
]

_FAMILIES = (model_checks, observer_checks, policy_checks, filter_checks, filter_kalman)


def check_model(factory: Factory) -> list[Outcome]:
    """Check the models that ``factory()`` makes; raises ConformanceError."""
    return demand("model", factory)


def check_observer(factory: Factory) -> list[Outcome]:
    """Check the observers that ``factory()`` makes; raises ConformanceError."""
    return demand("observer", factory)


def check_policy(factory: Factory) -> list[Outcome]:
    """Check the policies that ``factory()`` makes; raises ConformanceError."""
    return demand("policy", factory)


def check_filter(factory: Factory) -> list[Outcome]:
    """Check the filters that ``factory()`` makes; raises ConformanceError."""
    return demand("filter", factory)
