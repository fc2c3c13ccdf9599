"""Every built-in plugin conforms."""

from __future__ import annotations

import pytest

from dafw.authoring.checks import factory_of
from dafw.core.registry import registry
from dafw.testing import run_checks

BUILT_IN = [registered.spec for registered in registry().plugins() if registered.spec.target.startswith("dafw.")]
DECLARED = {("ad", "steps_in_set"), ("ad_ins", "steps_in_set")}


@pytest.mark.parametrize("spec", BUILT_IN, ids=lambda spec: f"{spec.kind}-{spec.name}")
def test_a_built_in_plugin_conforms(spec):
    outcomes = list(run_checks(spec.kind, factory_of(spec)))
    assert [f"{outcome.check.name}: {outcome.detail}" for outcome in outcomes if not outcome.ok] == []
    declared = {(spec.name, outcome.check.name) for outcome in outcomes if outcome.status == "expected failure"}
    assert declared == {pair for pair in DECLARED if pair[0] == spec.name}
