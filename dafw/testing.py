"""The conformance kit: does a plugin do what its interface promises?

``check_filter(factory)``, ``check_model(factory)`` and so on run every check of their kind on the plugins that
``factory()`` makes, return the outcomes, and raise ConformanceError naming every check that failed. ``run_checks``
yields the outcomes one by one. A plugin declares checks that it is meant to fail, each with a reason, in
``expected_failures``.
docs/conformance.md says what each check is for.

>>> from dafw.testing import check_filter
>>> from dafw.plugins.filters.etkf import ETKF
>>> {outcome.status for outcome in check_filter(ETKF)} <= {"passed", "not applicable"}
True
"""

from __future__ import annotations

from dafw.authoring.kit import (
    CHECKS,
    Check,
    ConformanceError,
    Outcome,
    check_executor,
    check_filter,
    check_model,
    check_observer,
    check_policy,
    check_readings,
    run_check,
    run_checks,
)

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
