"""What the filters with re-runs have in common: which readings, which controls, members that cannot be run."""

from dataclasses import dataclass

import numpy as np
import pytest
from decays import (
    AMOUNTS,
    CYCLES,
    MEAN,
    P0,
    SD,
    VALUES,
    Decay,
    N,
    Pair,
    cycles_of,
    decay_cycles,
    exact_draws,
    listed,
    rauch_tung_striebel,
)

from dafw import ConfigurationError, Filter, StateSpace, Variable
from dafw.authoring.filter_windows import Elsewhere
from dafw.core.ensemble import Analysis
from dafw.core.errors import DivergenceError
from dafw.plugins.filters.compared import Comparison
from dafw.plugins.filters.esmda import ESMDA
from dafw.plugins.filters.ienks import IEnKS
from dafw.plugins.filters.rerunning import reached
from dafw.plugins.filters.restart_enkf import RestartEnKF
from dafw.testing import CHECKS, run_check

ALL = [ESMDA(), ESMDA(window=3), IEnKS(), IEnKS(window=3), IEnKS(variant="bundle"), RestartEnKF()]
NAMES = ["esmda", "esmda-window", "ienks", "ienks-window", "ienks-bundle", "restart_enkf"]


def reported(cycle, name):
    """Return a diagnostic of the filter; None where it reported none."""
    found = cycle.analysis.diagnostics.get(name)
    return None if found is None else float(found.values)


# Members that cannot be run ----------------------------------------------------------------------------------------


def hard_start():
    """Return a first guess whose rates lie below the true one, so that an update goes beyond the limit of 0.4."""
    return np.column_stack([np.linspace(1.2, 1.6, 8), np.array([0.2, 0.33, 0.25, 0.39, 0.3, 0.22, 0.36, 0.28])])


@pytest.mark.parametrize("filter_", ALL, ids=NAMES)
@pytest.mark.parametrize("fault", ["member", "no member"])
def test_a_member_that_cannot_be_run_does_not_go_all_the_way(filter_, fault):
    cycles = decay_cycles(filter_, Decay(limit=0.4, fault=fault, start=hard_start()), members=8)
    assert len(cycles) == 6
    assert sum(reported(cycle, "runs_failed") for cycle in cycles) > 0
    for cycle in cycles:
        assert cycle.belief.members[:, 1].max() <= 0.4
    free = decay_cycles(filter_, Decay(start=hard_start()), members=8)
    assert free[-1].belief.members[:, 1].max() > 0.4
    assert sum(reported(cycle, "runs_failed") for cycle in free) == 0


@dataclass
class LateFault(Decay):
    """Cannot be stepped from the fourth cycle on with a rate above 0.8."""

    def step_with_memory(self, members, memory, t, rng):
        self.limit = 0.8 if t >= 3.0 else np.inf
        return super().step_with_memory(members, memory, t, rng)


@pytest.mark.parametrize("filter_", [ESMDA(), IEnKS(), RestartEnKF(readings="all")], ids=["esmda", "ienks", "restart"])
@pytest.mark.parametrize("fault", ["member", "no member"])
def test_a_member_of_the_first_guess_that_fails_later_comes_nearer_to_the_mean(filter_, fault):
    start = np.column_stack([np.linspace(1.3, 1.5, 8), np.linspace(0.25, 0.9, 8)])
    cycles = decay_cycles(filter_, LateFault(start=start, fault=fault), members=8)
    assert [reported(cycle, "runs_failed") > 0 for cycle in cycles] == [False] * 3 + [True] * 3
    assert np.abs(cycles[-1].belief.mean[1] - 0.45) < 0.05


def test_where_members_are_placed_after_failures():
    before, after = np.array([[0.0], [8.0]]), np.array([[16.0], [8.0]])
    places = [reached(before, after, np.array([tries, 0]))[0, 0] for tries in range(11)]
    assert places == [16.0, 8.0, 4.0, 2.0, 1.0, 0.0, 2.0, 3.0, 3.5, 3.75, 4.0]


def test_the_other_members_go_all_the_way():
    filter_ = ESMDA(every=6, iterations=1)
    free = decay_cycles(filter_, Decay(start=hard_start()), members=8)[-1]
    reached = free.belief.members[:, 1]
    limit = float(np.sort(reached)[-3])
    assert limit > hard_start()[:, 1].max()
    limited = decay_cycles(filter_, Decay(limit=limit, start=hard_start()), members=8)[-1]
    stopped = reached > limit
    assert stopped.sum() == 2 and reported(limited, "runs_failed") >= stopped.sum()
    np.testing.assert_array_equal(limited.belief.members[~stopped], free.belief.members[~stopped])
    # In logarithms the others made a half, a quarter, ... of their way, or none of it.
    share = np.log(limited.belief.members[stopped, 1] / hard_start()[stopped, 1])
    share /= np.log(reached[stopped] / hard_start()[stopped, 1])
    assert all(min(abs(one - part) for part in (0.5, 0.25, 0.125, 0.0625, 0.0)) < 1e-12 for one in share)


@pytest.mark.parametrize("filter_", ALL, ids=NAMES)
def test_halved_moves_have_the_same_bits_wherever_members_are_stepped(filter_):
    model = Decay(limit=0.4, start=hard_start())
    here, there = (decay_cycles(filter_, model, members=8, **options) for options in ({}, {"executor": Elsewhere()}))
    for one, other in zip(here, there, strict=True):
        assert one.belief.members.tobytes() == other.belief.members.tobytes()


@dataclass
class Wearing(Decay):
    """It cannot be stepped in the second cycle, wherever the members are."""

    def step_with_memory(self, members, memory, t, rng):
        if t == 1.0 and self.fault == "now":
            raise DivergenceError("worn out")
        return super().step_with_memory(members, memory, t, rng)


@dataclass
class Spoiling(Filter):
    """Leaves the model unable to be run again."""

    inner: Filter
    model: Wearing
    window = None
    past_beliefs = "first"

    def analyse_window(self, window, rng):
        if window.cycles[-1].number < 1:
            return Analysis(window.forecast.ensemble.members)
        self.model.fault = "now"
        return self.inner.analyse_window(window, rng)


@pytest.mark.parametrize("inner", [ESMDA(), IEnKS(), RestartEnKF()], ids=["esmda", "ienks", "restart_enkf"])
def test_a_model_that_fails_where_no_member_was_moved_ends_the_study(inner):
    model = Wearing()
    with pytest.raises(DivergenceError, match="worn out"):
        decay_cycles(Spoiling(inner, model), model)


# Which readings ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("filter_", "used"),
    [
        (ESMDA(), [1, 2, 3, 4, 5, 6]),
        (ESMDA(every=3), [None, None, 3, None, None, 6]),
        (ESMDA(window=4), [1, 1, 1, 1, 1, 1]),
        (ESMDA(window=4, every=2), [None, 2, None, 2, None, 2]),
        (RestartEnKF(), [1, 1, 1, 1, 1, 1]),
        (RestartEnKF(every=3), [None, None, 3, None, None, 3]),
        (RestartEnKF(readings="all", every=2), [None, 2, None, 4, None, 6]),
    ],
    ids=["all", "all-every", "new", "new-every", "restart", "restart-every", "restart-all"],
)
def test_each_analysis_uses_the_readings_it_should(filter_, used):
    cycles = decay_cycles(filter_)
    assert [reported(cycle, "readings_used") for cycle in cycles] == used
    for cycle in cycles:
        if reported(cycle, "readings_used") is None:
            np.testing.assert_array_equal(cycle.belief.members, cycle.forecast.members)


def used_of(filter_, silent, late=(), arrives=0.0):
    """Return how many readings the analysis of each cycle used; that of the cycle ``late`` came at the time given."""
    readings = listed(AMOUNTS, 0.02, silent)
    for one in readings.readings:
        if one["time"] - 1.0 in late:
            one["arrives"] = arrives
    cycles = cycles_of(Decay(), filter_, readings, 6, 10)
    assert sum(reported(cycle, "readings_missed") or 0 for cycle in cycles) == 0
    return [reported(cycle, "readings_used") for cycle in cycles]


@pytest.mark.parametrize(
    ("filter_", "silent", "used"),
    [
        (ESMDA(every=2), (1, 3, 5), [None, 1, None, 2, None, 3]),
        (IEnKS(every=3), (1, 2, 3, 5), [None, None, 1, None, None, 2]),
        (IEnKS(window=4, every=2), (1, 3, 5), [None, 1, None, 1, None, 1]),
        (ESMDA(window=3, every=3), (1, 2, 4, 5), [None, None, 1, None, None, 1]),
        (RestartEnKF(every=2), (1, 3), [None, 1, None, 1, None, 2]),
        (RestartEnKF(readings="all", every=2), (1, 2, 3), [None, 1, None, None, None, 3]),
    ],
    ids=["esmda", "ienks", "ienks-window", "esmda-window", "restart", "restart-all"],
)
def test_readings_are_used_though_nothing_is_read_in_the_cycles_of_analyses(filter_, silent, used):
    """Those of observers come at the ends of cycles 0, S, 2 S, ...; analyses are due in cycles S - 1, 2 S - 1, ..."""
    assert used_of(filter_, silent) == used


def test_a_reading_about_to_leave_the_window_is_used_before_its_time():
    # Analyses are due in cycles 2 and 5. The reading of cycle 1 comes in cycle 3, and leaves after cycle 3, or after 4.
    assert used_of(RestartEnKF(every=3), (), {1}, 4.0) == [None, None, 2, None, None, 4]  # to the start: nothing leaves
    assert used_of(IEnKS(window=3, every=3), (), {1}, 4.0) == [None, None, 2, 2, None, 2]
    assert used_of(IEnKS(window=4, every=3), (4,), {1}, 4.0) == [None, None, 2, None, 2, 1]


@pytest.mark.parametrize("filter_", [ESMDA(every=3), RestartEnKF(every=3), IEnKS(window=4, every=3)])
def test_a_run_that_is_cut_off_while_readings_wait_goes_on_with_the_same_bits(filter_):
    outcome = run_check(CHECKS["filter"]["restart"], lambda: filter_)
    assert outcome.status == "passed", outcome.detail


# Which controls ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("filter_", [ESMDA, IEnKS, RestartEnKF])
def test_only_the_controls_move(filter_):
    cycle = decay_cycles(filter_(estimate=["rate"]), members=6)[0]
    first = np.exp(np.log(cycle.forecast.members) + [1.0, 0.0] * cycle.forecast.members[:, 1:])[:, 0]
    moved = cycle.belief.members
    np.testing.assert_allclose(moved[:, 0] * np.exp(moved[:, 1]), first, rtol=1e-12)
    assert np.abs(moved[:, 1] - cycle.forecast.members[:, 1]).min() > 0.0


@pytest.mark.parametrize(
    "filter_", [IEnKS(estimate=["right"], window=CYCLES, iterations=1), RestartEnKF(estimate=["right"])]
)
def test_numbers_that_are_unknown_but_not_estimated_count_as_unknown(filter_):
    """The estimated one has the mean and variance that it has if both are estimated."""
    model, readings = Pair(exact_draws(N, MEAN, P0)), listed(VALUES[:1], SD)
    first = cycles_of(model, filter_, readings, 1, N)[-1].analysis.revised[0].ensemble
    means, covariances = rauch_tung_striebel([0], 1)
    assert first.mean[1] == pytest.approx(means[0][1], abs=1e-9)
    assert first.variance[1] == pytest.approx(covariances[0][1, 1], abs=1e-9)
    np.testing.assert_array_equal(first.members[:, 0], model.members[:, 0])


def test_few_controls_are_found_by_regression_on_them_alone():
    """Ten members that differ in one number: what is bent in it is not taken for an effect of eight others."""
    start = np.column_stack([np.full(10, 1.4), np.exp(np.linspace(-2.0, 0.0, 10))])
    last = decay_cycles(IEnKS(every=6, iterations=1), Decay(start=start), sd=0.01)[-1]
    z, predicted = np.log(start[:, 1]), 1.4 * np.exp(-start[:, 1:] * np.arange(1, 7))
    slope = (z - z.mean()) @ (predicted - predicted.mean(axis=0)) / np.sum((z - z.mean()) ** 2)
    variance = 1.0 / (1.0 / z.var(ddof=1) + slope @ slope / 0.01**2)
    mean = z.mean() + variance * slope @ (AMOUNTS - predicted.mean(axis=0)) / 0.01**2
    found = np.log(last.belief.members[:, 1])
    assert found.mean() == pytest.approx(mean, rel=1e-9) and found.var(ddof=1) == pytest.approx(variance, rel=1e-9)
    # A single step from members far apart takes what is bent for uncertain.
    other = decay_cycles(RestartEnKF(every=6), Decay(start=start), sd=0.01)[-1]
    assert np.log(other.belief.members[:, 1]).var(ddof=1) > 2.0 * variance


@dataclass
class Filling(Decay):
    """Its tank at the start is ten times the rate, and drains into the amount."""

    def __post_init__(self):
        self.space = StateSpace([Variable("tank", 2), Variable("rate", 1)])

    def initial(self, n_members, rng):
        return self.settled(rng.draw(n_members, lambda one: np.array([0.0, 0.0, 1.0 + 0.3 * one.standard_normal()])))

    def settled(self, members):
        return np.column_stack([10.0 * members[:, 2], 10.0 * members[:, 2], members[:, 2]])

    def step_with_memory(self, members, memory, t, rng):
        from dafw import Step

        return Step(members * [0.5, 0.5, 1.0], {"steps": memory["steps"] + 1.0})


@pytest.mark.parametrize("filter_", [ESMDA, IEnKS])
def test_fields_follow_from_the_controls_at_the_release_and_there_alone(filter_):
    def cycles(**options):
        return cycles_of(Filling(), filter_(**options), listed([4.0, 2.0, 1.0, 0.5], 0.1), 4, 6)

    for cycle in cycles():
        members = cycle.belief.members
        np.testing.assert_allclose(members[:, 0], 10.0 * members[:, 2] * 0.5**cycle.state.cycle, rtol=1e-12)
    # In a window that begins later, the tank is what it is.
    before, after = cycles(window=1)[1:3]
    np.testing.assert_array_equal(after.belief.members[:, :2], 0.5 * before.belief.members[:, :2])
    # A tank that is a control itself does not follow from the rate.
    members = cycles(estimate=["tank"])[0].belief.members
    assert np.abs(members[:, 0] - 5.0 * members[:, 2]).min() > 1e-3


@pytest.mark.parametrize("filter_", ALL, ids=NAMES)
def test_the_models_memory_belongs_to_the_new_members(filter_):
    for done, cycle in enumerate(decay_cycles(filter_), 1):
        np.testing.assert_array_equal(cycle.state.belief.memory["steps"], float(done))
        for number, belief in cycle.analysis.revised.items():
            np.testing.assert_array_equal(belief.memory["steps"], float(number))


# Refused -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("filter_", [ESMDA, IEnKS, RestartEnKF])
def test_controls_that_there_are_not_are_refused_before_anything_is_computed(filter_):
    with pytest.raises(ConfigurationError, match=r"no state variable 'wind' \(there are: amount, rate\)"):
        decay_cycles(filter_(estimate=["wind"]))


@pytest.mark.parametrize("filter_", [ESMDA, IEnKS])
def test_a_window_in_which_readings_would_be_left_out_is_refused(filter_):
    with pytest.raises(ConfigurationError, match="every must be at most window"):
        decay_cycles(filter_(window=2, every=3))


@dataclass
class Weighing(Filter):
    """Gives weights to the members that another filter must take."""

    inner: Filter
    window = None

    def analyse_window(self, window, rng):
        if window.cycles[-1].number == 0:
            return Analysis(window.forecast.ensemble.members, weights=np.full(10, 0.1))
        return self.inner.analyse_window(window, rng)


def test_members_with_weights_are_refused():
    with pytest.raises(ConfigurationError, match="expected members that count equally, got members with weights"):
        decay_cycles(Weighing(ESMDA()))


# How readings are compared -----------------------------------------------------------------------------------------

READ = np.array([0.5, 0.0, -0.02])
R = np.array([[4e-4, 1e-4, 0.0], [1e-4, 1e-4, 0.0], [0.0, 0.0, 9e-4]])


def test_model_error_is_added_to_the_readings_error():
    comparison = Comparison(model_error=0.03, relative_model_error=0.2)
    expected = np.add(np.diag(R), [9e-4 + 0.01, 9e-4, 9e-4 + 1.6e-5])
    np.testing.assert_allclose(comparison.covariance(READ, np.diag(R)), expected, rtol=1e-14)
    full = comparison.covariance(READ, R)
    np.testing.assert_allclose(np.diag(full), expected, rtol=1e-14)
    np.testing.assert_array_equal(full - np.diag(np.diag(full)), R - np.diag(np.diag(R)))
    np.testing.assert_array_equal(comparison.of(READ), READ)


def test_logarithms_take_what_is_below_zero_for_nothing():
    comparison = Comparison(logarithm=True, floor=0.01)
    np.testing.assert_allclose(comparison.of(READ), np.log([0.51, 0.01, 0.01]), rtol=1e-14)
    sd = np.sqrt(comparison.covariance(READ, np.diag(R)))
    np.testing.assert_allclose(sd, np.log1p(np.array([0.02 / 0.51, 0.01 / 0.01, 0.03 / 0.01])), rtol=1e-14)
    full = comparison.covariance(READ, R)
    np.testing.assert_allclose(np.sqrt(np.diag(full)), sd, rtol=1e-14)
    np.testing.assert_allclose(full[0, 1] / (sd[0] * sd[1]), R[0, 1] / np.sqrt(R[0, 0] * R[1, 1]), rtol=1e-14)
    small = comparison.covariance(READ, 1e-12 * R)  # errors so small that the logarithm is straight
    np.testing.assert_allclose(np.sqrt(np.diag(small)), np.sqrt(1e-12 * np.diag(R)) / [0.51, 0.01, 0.01], rtol=1e-5)


@pytest.mark.parametrize("filter_", [ESMDA, IEnKS, RestartEnKF])
def test_in_logarithms_a_decay_is_linear_and_found_at_once(filter_):
    # log(amount) is linear in log(amount at the start) and in the rate, and the rate is known here.
    start = np.column_stack([np.exp(np.linspace(-3.0, 3.0, 9)), np.full(9, 0.45)])
    model = Decay(start=start)
    filter_ = filter_(estimate=["amount"], every=6, transform="log", floor=1e-12)
    last = decay_cycles(filter_, model, members=9, sd=1e-4)[-1]
    found = last.belief.members[:, 0] / AMOUNTS[-1]
    if isinstance(filter_, ESMDA):
        np.testing.assert_allclose(found, 1.0, rtol=2e-3)
    else:
        np.testing.assert_allclose(found.mean(), 1.0, rtol=1e-6)
