"""The conformance kit in pytest: one test for each check of a registered plugin.

It is installed with dafw and does nothing until a test uses the argument ``dafw_check``::

    @pytest.mark.dafw("filter", "nudging")
    def test_conforms(dafw_check):
        dafw_check()

A check that the plugin declares to fail is an expected failure (xfail, strict) with the plugin's reason.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker ``dafw``."""
    config.addinivalue_line("markers", "dafw(kind, name): the registered plugin that dafw_check is about")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Make one test for each check."""
    if "dafw_check" not in metafunc.fixturenames:
        return
    import pytest

    from dafw.authoring.checks import NotApplicable, factory_of
    from dafw.authoring.kit import CHECKS
    from dafw.core.hookspecs import PluginSpec

    mark = metafunc.definition.get_closest_marker("dafw")
    if mark is None or len(mark.args) != 2:
        raise pytest.UsageError(f'{metafunc.definition.name}: expected the mark @pytest.mark.dafw("kind", "name")')
    kind, name = mark.args
    factory = factory_of(PluginSpec(kind, name, ""))
    expected = factory().expected_failures

    def bound(run):
        def call() -> None:
            try:
                run(factory)
            except NotApplicable as reason:
                pytest.skip(str(reason))

        return call

    metafunc.parametrize(
        "dafw_check",
        [
            pytest.param(
                bound(check.run),
                id=check.name,
                marks=[pytest.mark.xfail(reason=expected[check.name], strict=True)] if check.name in expected else [],
            )
            for check in CHECKS[kind].values()
        ],
    )
