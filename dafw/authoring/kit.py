"""The checks of all kinds of plugins, and the functions that run them; public as ``dafw.testing``."""

from __future__ import annotations

from dafw.authoring import (
    executor_checks,
    filter_checks,
    filter_kalman,
    filter_windows,
    model_checks,
    observer_checks,
    policy_checks,
    readings_checks,
)
from dafw.authoring.checks import CHECKS, Check, ConformanceError, Factory, Outcome, demand, run_check, run_checks

__all__ = [
    "CHECKS",
    "Check",
    "ConformanceError",
    "Outcome",
    "check_executor",
    "check_filter",
    "check_model",
    "check_observer",
    "check_policy",
    "check_readings",
    "run_check",
    "run_checks",
]

_FAMILIES = (
    model_checks,
    observer_checks,
    policy_checks,
    filter_checks,
    filter_kalman,
    filter_windows,
    readings_checks,
    executor_checks,
)


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


def check_readings(factory: Factory) -> list[Outcome]:
    """Check the sources of readings that ``factory()`` makes; raises ConformanceError."""
    return demand("readings", factory)


def check_executor(factory: Factory) -> list[Outcome]:
    """Check the executors that ``factory()`` makes; raises ConformanceError."""
    return demand("executor", factory)
