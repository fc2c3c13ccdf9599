"""Arguments and results of filters that look back; weights; late readings; policies that look ahead."""

import pickle
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from toys import NODES, Counting, Growth, OneNode, toy_parts

from dafw import (
    Analysis,
    ContractError,
    Ensemble,
    Filter,
    Observation,
    Policy,
    Readings,
    Route,
    Selection,
    Vehicle,
)
from dafw.core.cycle import advance, start
from dafw.core.late import sort_by_cycle

VEHICLE = Vehicle(np.zeros((1, 2)), speed=1.0, dt=2.0)
NODE_0 = Selection(indices=np.array([0]), covariance=np.array([0.01]))


@dataclass
class Watching(Filter):
    """Keeps the windows that it is given, and nudges the present."""

    window: int | None = None
    seen: list = field(default_factory=list)
    revise: bool = False

    def analyse_window(self, window, rng):
        self.seen.append(window)
        moved = window.forecast.ensemble.members + 0.25 * (
            window.observation.values.sum() - window.predicted.sum() / 5.0
        )
        revised = {}
        if self.revise:
            revised = {one.number: one.belief.with_members(one.belief.ensemble.members + 1.0) for one in window.cycles}
        return Analysis(moved, {"count": np.array(len(self.seen))}, revised=revised)


class First(Watching):
    past_beliefs = "first"


@dataclass
class Scripted(Readings):
    """Returns given observations (time, value) of node 0 in given cycles."""

    script: dict = field(default_factory=dict)

    def take(self, request, rng):
        return [Observation(np.array([value]), NODE_0, time) for time, value in self.script.get(request.cycle, [])]


def fly(parts, cycles, state=None):
    """Return the cycles; toy cycles last two seconds."""
    state = state or start(parts, 5, VEHICLE)
    done = []
    for _ in range(cycles):
        done.append(advance(parts, state))
        state = done[-1].state
    return done


def no_truth(filter_, script, **changes):
    return toy_parts(filter=filter_, readings=Scripted(script=script), truth=None, free=None, **changes)


EVERY = {cycle: [(2.0 * cycle + 2.0, 1.0 + cycle)] for cycle in range(6)}
SILENT = {cycle: readings for cycle, readings in EVERY.items() if cycle not in (1, 3)}


def test_a_window_since_the_start_holds_all_cycles_silent_ones_too():
    filter_ = Watching()
    done = fly(no_truth(filter_, SILENT, model=Counting(spread=0.5, noise=0.1)), 6)
    assert [len(window.cycles) for window in filter_.seen] == [1, 3, 5, 6]  # called only in cycles with readings
    last = filter_.seen[-1]
    assert [cycle.number for cycle in last.cycles] == list(range(6))
    assert [cycle.observation.values.tolist() for cycle in last.cycles] == [[1.0], [], [3.0], [], [5.0], [6.0]]
    for cycle, flown in zip(last.cycles[1:], done, strict=False):
        assert cycle.belief.ensemble.members.tobytes() == flown.state.belief.ensemble.members.tobytes()
        np.testing.assert_array_equal(cycle.belief.memory["steps"], cycle.number)
    assert last.forecast.ensemble.members.tobytes() == done[-1].forecast.members.tobytes()
    np.testing.assert_array_equal(last.forecast.memory["steps"], 6.0)
    np.testing.assert_array_equal(last.predicted[:, 0], done[-1].forecast.members[:, 0])
    assert int(last.memory["count"]) == 3
    assert last.values.tolist() == [1.0, 3.0, 5.0, 6.0] and last.covariance.shape == (4,)


@pytest.mark.parametrize("size", [1, 2, 4])
def test_a_window_of_so_many_cycles_holds_no_more(size):
    filter_ = Watching(window=size)
    done = fly(no_truth(filter_, EVERY), 6)
    numbers = [[cycle.number for cycle in window.cycles] for window in filter_.seen]
    assert numbers == [list(range(max(0, last - size + 1), last + 1)) for last in range(6)]
    assert len(done[-1].state.past) == size - 1


def test_a_filter_that_needs_the_first_belief_alone_holds_no_other():
    filter_ = First()
    fly(no_truth(filter_, EVERY), 4)
    last = filter_.seen[-1]
    assert [cycle.belief is None for cycle in last.cycles] == [False, True, True, False]
    assert last.first.ensemble.time == 0.0
    with pytest.raises(ContractError, match="no belief after cycle 0"):
        last.belief_after(0)
    assert last.replay().stacked().shape == (5, 4)


def test_revised_beliefs_are_the_past_of_the_next_window():
    filter_ = Watching(revise=True)
    fly(no_truth(filter_, EVERY), 3)
    first, second, third = (window.cycles[0].belief.ensemble.members for window in filter_.seen)
    np.testing.assert_array_equal(second, first + 1.0)
    np.testing.assert_array_equal(third, first + 2.0)


def test_members_of_an_analysis_may_bring_the_models_memory_with_them():
    class Fresh(Watching):
        def analyse_window(self, window, rng):
            return replace(super().analyse_window(window, rng), model_memory={"steps": np.full(5, 100.0)})

    done = fly(no_truth(Fresh(), EVERY, model=Counting()), 2)
    np.testing.assert_array_equal(done[0].state.belief.memory["steps"], 100.0)
    np.testing.assert_array_equal(done[1].state.past[1].belief.memory["steps"], 100.0)
    done = fly(no_truth(Watching(), EVERY, model=Counting()), 2)
    np.testing.assert_array_equal(done[1].state.belief.memory["steps"], 2.0)


def test_a_run_with_a_window_cut_anywhere_continues_to_the_same_bits():
    def parts():
        return no_truth(Watching(window=3, revise=True), SILENT, model=Counting(spread=0.5, noise=0.1))

    whole = fly(parts(), 6)[-1].state
    for cut in range(1, 6):
        half = fly(parts(), cut)[-1].state
        rest = fly(parts(), 6 - cut, pickle.loads(pickle.dumps(half)))[-1].state
        assert rest.belief.ensemble.members.tobytes() == whole.belief.ensemble.members.tobytes()
        for one, other in zip(rest.past, whole.past, strict=True):
            assert one.belief.ensemble.members.tobytes() == other.belief.ensemble.members.tobytes()


@pytest.mark.parametrize(
    ("revised", "message"),
    [
        (lambda belief: {7: belief}, "revised after 7 cycles lies outside its window, which goes back to cycle 0"),
        (lambda belief: {0: belief.ensemble}, "must be a Forecast, got Ensemble"),
        (lambda belief: {0: belief.with_members(np.zeros((4, 5)))}, r"revised after 0 cycles must have the shape"),
        (lambda belief: {0: belief.with_members(np.full((5, 5), np.nan))}, "revised after 0 cycles holds nan"),
    ],
)
def test_a_revision_that_cannot_be_is_refused(revised, message):
    class Wrong(Watching):
        def analyse_window(self, window, rng):
            return Analysis(window.forecast.ensemble.members, revised=revised(window.first))

    with pytest.raises(ContractError, match=f"phase 'analyse': filter 'Wrong': .*{message}"):
        fly(no_truth(Wrong(), EVERY), 1)


def test_a_filter_with_a_window_and_no_verb_for_it_says_what_is_missing():
    class Half(Filter):
        window = 3

    with pytest.raises(Exception, match=r"filter 'Half' has a window and must define analyse_window\(window, rng\)"):
        fly(no_truth(Half(), EVERY), 1)


# Late readings

LATE = {0: [(2.0, 1.0)], 1: [], 2: [(6.0, 3.0), (4.0, 20.0), (1.5, 10.0)], 3: [(8.0, 4.0)]}


def test_a_late_reading_reaches_a_window_in_the_cycle_that_it_belongs_to():
    filter_ = Watching()
    done = fly(no_truth(filter_, LATE), 4)
    third = filter_.seen[1]
    assert third.observation.values.tolist() == [3.0]
    assert [(cycle, one.values.tolist()) for cycle, one in third.late] == [(1, [20.0]), (0, [10.0])]
    assert [cycle.observation.values.tolist() for cycle in third.cycles] == [[1.0, 10.0], [20.0], [3.0]]
    assert [cycle.observation.values.tolist() for cycle in filter_.seen[2].cycles[:2]] == [[1.0, 10.0], [20.0]]
    assert filter_.seen[2].late == ()
    assert done[2].readings.counts["late_in_window"] == 2


@pytest.mark.parametrize(("choice", "used"), [("drop", [3.0]), ("use", [3.0, 20.0, 10.0])])
def test_without_a_window_a_late_reading_is_dropped_or_used_now_and_counted(choice, used):
    done = fly(no_truth(Reading(), LATE, late_readings=choice), 4)
    assert done[2].observation.values.tolist() == used
    assert done[2].predicted.shape == (5, len(used))
    kind = {"drop": "late_dropped", "use": "late_used_now"}[choice]
    assert done[2].readings.counts[kind] == 2 and done[2].readings.counts["on_time"] == 1
    assert len(done[2].readings.dropped) == (2 if choice == "drop" else 0)


class Reading(Filter):
    def analyse(self, forecast, predicted, observation, rng):
        return Analysis(forecast.members)


def test_what_a_short_window_cannot_reach_is_dropped_or_used_like_without_one():
    done = fly(no_truth(Watching(window=2), LATE), 4)
    assert done[2].readings.counts["late_in_window"] == 1 and done[2].readings.counts["late_dropped"] == 1


def test_late_readings_in_a_silent_cycle_are_reason_enough_to_ask_the_filter():
    filter_ = Watching()
    fly(no_truth(filter_, {0: [(2.0, 1.0)], 2: [(4.0, 9.0)]}), 3)
    assert len(filter_.seen) == 2 and filter_.seen[1].observation.values.size == 0


@pytest.mark.parametrize(
    ("time", "where"),
    [(6.0, 2), (4.0 + 1e-5, 2), (4.0, 1), (3.9, 1), (2.0 + 1e-12, 0), (0.1, 0), (0.0, None), (-3.0, None)],
)
def test_a_reading_belongs_to_the_cycle_in_whose_time_it_was_taken(time, where):
    from dafw.core.interfaces.readings import Request

    request = Request(2, 4.0, 6.0, toy_parts().model.space, None, NODE_0)
    sorted_ = sort_by_cycle([Observation(np.array([1.0]), NODE_0, time)], request, 2.0, [0, 1, 2], "drop")
    if where is None:
        assert sorted_.counts["before_start"] == 1 and len(sorted_.dropped) == 1
    elif where == 2:
        assert sorted_.now.values.size == 1 and sorted_.now.time == 6.0
    else:
        assert [number for number, _ in sorted_.late] == [where]


def test_a_late_reading_finds_its_cycle_after_many_rounded_steps():
    from dafw.core.interfaces.readings import Request

    times = np.cumsum(np.full(100_000, 0.1))
    for cycle in (99_999, 54_321, 77):
        request = Request(cycle, times[cycle - 1], times[cycle], toy_parts().model.space, None, NODE_0)
        exact = Observation(np.array([1.0]), NODE_0, round(cycle * 0.1, 1))  # end of the cycle before, rounded
        sorted_ = sort_by_cycle([exact], request, 0.1, [cycle - 1, cycle], "drop")
        assert [number for number, _ in sorted_.late] == [cycle - 1]


def test_a_reading_from_the_future_is_refused():
    with pytest.raises(ContractError, match=r"readings 'Scripted': a reading of t = 2.5 s was given in the cycle that"):
        fly(no_truth(Reading(), {0: [(2.5, 1.0)]}), 1)


def test_without_a_truth_there_is_none():
    done = fly(no_truth(Watching(), EVERY), 2)
    assert done[-1].truth is None and done[-1].state.truth is None and done[-1].state.free is None
    assert "truth" not in done[-1].seconds


# Weights

WEIGHTS = np.array([0.4, 0.3, 0.2, 0.1, 0.0])


class Weighing(Filter):
    def analyse(self, forecast, predicted, observation, rng):
        return Analysis(forecast.members, weights=WEIGHTS)


def test_weights_stay_with_the_members_through_the_next_step():
    done = fly(no_truth(Weighing(), {0: [(2.0, 1.0)]}), 2)
    for cycle in done:
        np.testing.assert_array_equal(cycle.state.belief.ensemble.weights, WEIGHTS)
    np.testing.assert_array_equal(done[1].forecast.weights, WEIGHTS)
    np.testing.assert_allclose(done[1].forecast.mean, WEIGHTS @ done[1].forecast.members)


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        (np.ones(4) / 4, r"5 members must have as many weights, got the shape \(4,\)"),
        (np.array([0.5, 0.7, -0.2, 0.0, 0.0]), "weights must not be negative and must add up to 1"),
        (np.full(5, 0.3), ".*must add up to 1"),
        (np.array([np.nan, 0.25, 0.25, 0.25, 0.25]), ".*must add up to 1"),
    ],
)
def test_weights_that_are_none_are_refused(weights, message):
    class Wrong(Filter):
        def analyse(self, forecast, predicted, observation, rng):
            return Analysis(forecast.members, weights=weights)

    with pytest.raises(ContractError, match=f"filter 'Wrong': {message}"):
        fly(no_truth(Wrong(), EVERY), 1)


# Policies that look ahead


@dataclass
class Ahead(Policy):
    looks_ahead = True
    seen: list = field(default_factory=list)

    def plan(self, outlook, rng):
        states = outlook.ahead(2).states
        read = outlook.ahead(2, [NODE_0, NODE_0])
        self.seen.append((outlook, states, read))
        return Route.hover(outlook.vehicle)


def test_a_policy_that_looks_ahead_runs_the_belief_on_with_its_memory():
    policy = Ahead()
    parts = toy_parts(policy=policy, model=Counting(spread=0.5, noise=0.1))
    done = fly(parts, 2)
    outlook, states, read = policy.seen[1]
    belief = done[0].state.belief
    assert outlook.belief is belief and outlook.cycle == 1
    np.testing.assert_array_equal(states[-1].memory["steps"], 3.0)
    assert [state.ensemble.time for state in states] == [4.0, 6.0]
    np.testing.assert_array_equal(read.predicted[2][:, 0], states[-1].ensemble.members[:, 0])
    # the model errors of a plan are not those of the belief
    assert not np.array_equal(states[0].ensemble.members, done[1].forecast.members)


def test_planning_leaves_the_run_as_it_is():
    one = fly(toy_parts(policy=Ahead(), model=Counting(spread=0.5, noise=0.1)), 3)[-1]

    class Hovering(Policy):
        def decide(self, belief, vehicle, rng):
            return Route.hover(vehicle)

    other = fly(toy_parts(policy=Hovering(), model=Counting(spread=0.5, noise=0.1)), 3)[-1]
    assert one.state.belief.ensemble.members.tobytes() == other.state.belief.ensemble.members.tobytes()


# Values that belong to a route, an operator and an ensemble


def test_an_observer_is_told_how_long_the_route_takes_and_may_report():
    from dafw import Diagnostic

    class Telling(OneNode):
        def operator(self, space, route, t):
            one = super().operator(space, route, t)
            return replace(one, diagnostics={"flown": Diagnostic(route.dt * 10.0, (), "m")})

    assert fly(toy_parts(observer=Telling()), 1)[0].diagnostics["observer"]["flown"].values == 20.0
    assert Route.hover(VEHICLE).dt == 2.0


@pytest.mark.parametrize("make", [lambda: Route((np.zeros((2, 3)),)), lambda: Vehicle(np.zeros((1, 3)))])
def test_places_in_three_dimensions_are_refused_and_not_cut_to_two(make):
    with pytest.raises(ContractError, match=r"must be points \(k, 2\) in metres, got the shape \(\d, 3\)"):
        make()


def test_what_is_frozen_is_the_ensembles_own():
    members = np.ones((2, 5))
    ensemble = Ensemble(members, Growth().space)
    members[0, 0] = 7.0  # the caller can still write to the array
    assert ensemble.members[0, 0] == 1.0 and not ensemble.members.flags.writeable
    view = Ensemble(NODES.ravel()[:5][np.newaxis], Growth().space)
    assert NODES.flags.writeable and view.members.shape == (1, 5)
