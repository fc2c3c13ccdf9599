"""The kit passes correct plugins and finds every fault of broken plugins by the check that is meant for it."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from broken import BROKEN
from broken.executors import LeavesAProcess, Patient
from broken.filters import LaterByMemory, LaterOnSelf, Square
from broken.models import Walk
from broken.observers import Ends, OverTime
from broken.policies import Ahead, East
from broken.readings import Sensor
from broken.smoothers import RevisesTheStart
from broken.weights import Weighing

from dafw import option
from dafw.authoring.evidence import require_mean
from dafw.plugins.filters.enks import EnKS
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.filters.none import NoFilter
from dafw.testing import CHECKS, ConformanceError, check_filter, run_checks

ALL = [(kind, name) for kind, checks in CHECKS.items() for name in checks]
# A plugin whose result is random fails every check that repeats a call.
IMPLIED = {
    ("policy", "determinism"): ["restart", "truth_blind"],
    ("readings", "determinism"): ["restart", "without_truth"],
}


@pytest.fixture(autouse=True)
def nothing_left():
    """End the processes that an executor deliberately leaves."""
    yield
    for process in LeavesAProcess.started:
        process.kill()
        process.wait()
    LeavesAProcess.started.clear()


FAULTS = [(kind, name, plugin) for (kind, name), plugins in BROKEN.items() for plugin in plugins]


@pytest.mark.parametrize(("kind", "name", "plugin"), FAULTS, ids=[f"{k}-{n}-{p.__name__}" for k, n, p in FAULTS])
def test_each_broken_plugin_is_caught_by_its_check_and_no_other(kind, name, plugin):
    outcomes = list(run_checks(kind, plugin))
    failed = [outcome.check.name for outcome in outcomes if outcome.status == "failed"]
    assert failed == [name, *IMPLIED.get((kind, name), [])]


def test_each_check_has_a_broken_plugin_that_it_alone_catches():
    assert sorted(BROKEN) == sorted(ALL)


@pytest.mark.parametrize("plugin", [Walk, Ends, OverTime, East, Ahead, Square, Weighing, Sensor, Patient])
def test_what_the_faults_were_added_to_is_right(plugin):
    outcomes = list(run_checks(plugin.kind, plugin))
    assert {outcome.status for outcome in outcomes} <= {"passed", "not applicable"}
    assert sum(outcome.status == "passed" for outcome in outcomes) >= 5


@pytest.mark.parametrize("plugin", [LaterOnSelf, LaterByMemory])
def test_a_fault_that_only_later_analyses_have_is_caught(plugin):
    failed = {outcome.check.name for outcome in run_checks("filter", plugin) if outcome.status == "failed"}
    assert failed >= {"member_order", "prior_kept", "kalman_exact"}
    assert ("restart" in failed) == (plugin is LaterOnSelf)


def test_a_belief_that_is_revised_outside_of_the_window_is_caught():
    outcomes = {outcome.check.name: outcome for outcome in run_checks("filter", RevisesTheStart)}
    assert outcomes["revised_in_set"].status == "failed"
    assert "lies outside its window, which goes back to cycle 1" in outcomes["revised_in_set"].detail


def test_options_are_tried_within_their_ranges():
    @dataclass
    class Narrow(EnKS):
        window: int | None = option(4, "cycles", minimum=3)
        inflation: float = option(1.0, "factor", minimum=1.0, maximum=1.1)

        def analyse_window(self, window, rng):
            if self.window < 3 or self.inflation > 1.1:
                raise RuntimeError("these options are refused before a study begins")
            return super().analyse_window(window, rng)

    check_filter(Narrow)


def test_inflation_and_localization_are_switched_off_where_the_kalman_filter_is_the_measure():
    check_filter(lambda: ETKF(inflation=1.3))


def test_a_failure_names_plugin_and_check():
    with pytest.raises(ConformanceError, match=r"filter 'Unbounded' does not conform: stays_in_set: failed, .*-"):
        check_filter(BROKEN["filter", "stays_in_set"][0])


def test_a_declared_failure_is_shown_with_its_reason():
    declared = type(
        "Declared", (BROKEN["filter", "prior_kept"][0],), {"expected_failures": {"prior_kept": "fixed gain"}}
    )
    outcome = {outcome.check.name: outcome for outcome in check_filter(declared)}["prior_kept"]
    assert (outcome.status, outcome.detail, outcome.ok) == ("expected failure", "fixed gain", True)


def test_a_declared_failure_that_passes_is_reported():
    declared = type("Declared", (NoFilter,), {"expected_failures": {"prior_kept": "once it did"}})
    with pytest.raises(ConformanceError, match="prior_kept: unexpected pass, declared to fail: once it did"):
        check_filter(declared)


def test_a_declared_failure_of_no_check_is_refused():
    declared = type("Declared", (NoFilter,), {"expected_failures": {"prior": "misspelt"}})
    with pytest.raises(ConformanceError, match=r"'prior', which is no check \(checks: shapes, "):
        check_filter(declared)


def test_the_order_of_checks_does_not_depend_on_what_was_imported_first():
    code = "import dafw.authoring.filter_windows; from dafw.testing import CHECKS; print(*CHECKS['filter'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == list(CHECKS["filter"])


def test_another_kind_is_refused():
    with pytest.raises(ConformanceError, match="expected the factory to make a filter, it made a Walk"):
        check_filter(Walk)


def test_an_unknown_accuracy_is_refused():
    with pytest.raises(ConformanceError, match=r"accuracy must be one of exact, statistical, none; got 'best'"):
        check_filter(type("Boaster", (ETKF,), {"accuracy": "best"}))


def test_an_exact_filter_is_also_statistically_right():
    check_filter(type("Modest", (ETKF,), {"accuracy": "statistical"}))


def test_a_rotated_ensemble_is_right():
    check_filter(lambda: ETKF(rotation=True))


@pytest.mark.parametrize("seed", range(20))
def test_the_mean_over_seeds_is_judged_by_its_own_error(seed):
    samples = np.random.default_rng(seed).standard_normal((64, 5))
    require_mean(samples, np.zeros(5), "unbiased")
    with pytest.raises(ConformanceError, match="biased: mean over 64 seeds"):
        require_mean(samples + np.array([0.0, 0.0, 1.5, 0.0, 0.0]), np.zeros(5), "biased")
