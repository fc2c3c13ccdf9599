"""Running the model again: a replay has the belief's bits, planning has its own random streams, many runs at once."""

from dataclasses import dataclass

import numpy as np
import pytest
from toys import Counting, Growth, Nudge, toy_parts
from trouble import Trouble, install

import dafw
from dafw import (
    Analysis,
    ComputationError,
    ConfigurationError,
    ContractError,
    Ensemble,
    Filter,
    Selection,
    StateSpace,
    Study,
    Variable,
    Vehicle,
)
from dafw.core.cycle import advance, start
from dafw.core.executors.batches import Batch
from dafw.core.executors.processes import Processes
from dafw.core.executors.serial import Serial
from dafw.core.registry import registry
from dafw.core.rerun import Rerun
from dafw.core.rng import Streams
from dafw.plugins.models.linear_advection import LinearAdvection
from dafw.plugins.observers.grid import Grid

VEHICLE = Vehicle(np.zeros((1, 2)), speed=1.0, dt=2.0)
TWO_NODES = Selection(indices=np.array([0, 2]), covariance=np.ones(2))


class Blind(Nudge):
    """Does not change the belief, so that a replay can be compared with it."""

    def analyse(self, forecast, predicted, observation, rng):
        return Analysis(forecast.members)


def flown(n_cycles, **changes):
    """Return the parts, and the states before and after each cycle."""
    parts = toy_parts(filter=Blind(), **({"model": Counting(spread=0.5, noise=0.1)} | changes))
    states = [start(parts, 5, VEHICLE)]
    for _ in range(n_cycles):
        states.append(advance(parts, states[-1]).state)
    return parts, states


@pytest.mark.parametrize(("first", "last"), [(0, 1), (0, 4), (2, 3), (1, 4)])
def test_a_replay_of_the_belief_has_its_bits_model_error_included(first, last):
    parts, states = flown(4)
    replay = parts.rerun(states[first].belief, first, last, keep=True)
    assert len(replay.states) == last - first
    for state, again in zip(states[first + 1 : last + 1], replay.states, strict=True):
        assert again.ensemble.members.tobytes() == state.belief.ensemble.members.tobytes()
        assert again.ensemble.time == state.belief.ensemble.time
        np.testing.assert_array_equal(again.memory["steps"], state.belief.memory["steps"])
    assert replay.forecast is replay.states[-1]


def test_times_are_summed_as_the_cycles_sum_them():
    parts, states = flown(7, **{role: Growth(dt=0.1) for role in ("model", "truth", "free")})
    assert parts.rerun(states[0].belief, 0, 7).forecast.ensemble.time == states[7].belief.ensemble.time
    assert parts.rerun(states[3].belief, 3, 7).forecast.ensemble.time == states[7].belief.ensemble.time


def test_readings_on_the_way_are_predicted():
    parts, states = flown(4)
    replay = parts.rerun(states[0].belief, 0, 4, operators={1: TWO_NODES, 3: TWO_NODES})
    assert replay.states == () and sorted(replay.predicted) == [1, 3]
    for cycle in (1, 3):
        expected = states[cycle + 1].belief.ensemble.members[:, [0, 2]]
        np.testing.assert_array_equal(replay.predicted[cycle], expected)
    np.testing.assert_array_equal(replay.stacked(), np.hstack([replay.predicted[1], replay.predicted[3]]))


def test_another_role_has_other_model_errors_and_never_those_of_the_truth():
    parts, states = flown(1, truth=Counting(spread=0.5, noise=0.1))
    belief = states[0].belief
    replay = parts.rerun(belief, 0, 1)
    for role in ("planning", "truth error"):
        other = parts.rerun(belief, 0, 1, role=role)
        assert not np.array_equal(other.forecast.ensemble.members, replay.forecast.ensemble.members)
        errors = parts.streams.members(role, 0)
        forbidden = parts.truth.forecast(belief.ensemble, belief.memory, errors)
        assert not np.array_equal(other.forecast.ensemble.members, forbidden.ensemble.members)


def test_any_number_of_members_runs_and_the_model_makes_their_memory():
    parts, states = flown(2)
    belief = states[0].belief.ensemble
    three = belief.with_members(np.tile(belief.members[:1], (3, 1)))
    replay = parts.rerun(three, 0, 2)
    assert replay.forecast.ensemble.members.shape == (3, 5)
    np.testing.assert_array_equal(replay.forecast.memory["steps"], 2.0)
    # a member's stream depends on its number: the first member has the same errors as before
    np.testing.assert_array_equal(
        replay.forecast.ensemble.members[0], parts.rerun(belief, 0, 2).forecast.ensemble.members[0]
    )


def test_weights_travel_with_the_members():
    parts, states = flown(1)
    weights = np.array([0.5, 0.2, 0.1, 0.1, 0.1])
    belief = states[0].belief.with_members(states[0].belief.ensemble.members, weights)
    np.testing.assert_array_equal(parts.rerun(belief, 0, 3).forecast.ensemble.weights, weights)


@pytest.mark.parametrize(
    ("first", "last", "operators", "message"),
    [
        (2, 2, None, "from a cycle to a later one, got 2 to 2"),
        (3, 1, None, "from a cycle to a later one"),
        (-1, 1, None, "from a cycle to a later one"),
        (0, 2, {2: TWO_NODES}, "cycles 0 to 1 has an operator for cycle 2"),
    ],
)
def test_a_re_run_that_means_nothing_is_refused(first, last, operators, message):
    parts, states = flown(1)
    with pytest.raises(ContractError, match=message):
        parts.rerun(states[0].belief, first, last, operators=operators)


class Filling(Growth):
    """The gas at the start is ten times the rate."""

    def settled(self, members):
        settled = members.copy()
        settled[:, :4] = 10.0 * members[:, 4:]
        return settled


def test_fields_at_the_start_follow_from_single_numbers_where_the_model_says_so():
    moved = flown(0)[1][0].belief.ensemble.with_members(np.arange(10.0).reshape(2, 5))
    plain, filling = (flown(0, model=model)[0].rerun.settled(moved) for model in (Growth(), Filling()))
    np.testing.assert_array_equal(plain.members, moved.members)
    np.testing.assert_array_equal(filling.members[:, :4], np.repeat(10.0 * moved.members[:, 4:], 4, axis=1))


# In worker processes


@pytest.fixture
def trouble(tmp_path, monkeypatch):
    """Register the model `trouble` for this process and its workers; return it and seven of its members."""
    install(tmp_path, monkeypatch)
    model = Trouble()
    model.name = "trouble"
    return model, model.first_guess(7, Streams(4).members("initial", 0))


def test_several_runs_are_under_way_at_once_and_each_gets_its_own_numbers(trouble):
    model, belief = trouble
    ones = {number: belief.with_members(belief.ensemble.members + number) for number in range(4)}
    serial = Rerun(model, Serial(), Streams(4))
    expected = {number: serial(one, 0, number + 1) for number, one in ones.items()}
    with Processes(workers=2) as executor:
        executor.start(model, {"name": "trouble"})
        rerun = Rerun(model, executor, Streams(4))
        under_way = {number: rerun.begin(one, 0, number + 1) for number, one in ones.items()}
        found = {number: under_way[number]() for number in (2, 0, 3)}  # fetched in another order, and one not at all
    for number, replay in found.items():
        assert replay.forecast.ensemble.members.tobytes() == expected[number].forecast.ensemble.members.tobytes()
        np.testing.assert_array_equal(replay.forecast.memory["way"], expected[number].forecast.memory["way"])


def test_a_run_of_many_cycles_in_workers_has_the_bits_of_one_here(trouble):
    model, belief = trouble
    operator = Selection(indices=np.array([1]), covariance=np.ones(1))
    replays = []
    for executor in (Serial(), Processes(workers=3)):
        with executor:
            executor.start(model, {"name": "trouble"})
            replays.append(Rerun(model, executor, Streams(4))(belief, 2, 6, operators={3: operator}, keep=True))
    here, there = replays
    assert [s.ensemble.members.tobytes() for s in here.states] == [s.ensemble.members.tobytes() for s in there.states]
    assert here.predicted[3].tobytes() == there.predicted[3].tobytes()


def test_a_worker_that_is_killed_under_several_runs_is_replaced_and_all_of_them_end(trouble, tmp_path):
    _, belief = trouble
    options = {"kind_of": "killed_once", "marker": str(tmp_path / "once")}
    model = Trouble(**options)
    model.name = "trouble"
    expected = [Rerun(Trouble(), Serial(), Streams(4))(belief, cycle, cycle + 2) for cycle in (0, 3)]
    with Processes(workers=2) as executor:
        executor.start(model, {"name": "trouble", **options})
        rerun = Rerun(model, executor, Streams(4))
        under_way = [rerun.begin(belief, cycle, cycle + 2) for cycle in (0, 3)]
        found = [wait() for wait in reversed(under_way)][::-1]
    assert (tmp_path / "once").exists()
    for one, other in zip(expected, found, strict=True):
        assert one.forecast.ensemble.members.tobytes() == other.forecast.ensemble.members.tobytes()


def test_a_run_whose_workers_die_again_and_again_fails_alone(trouble):
    _, belief = trouble
    model = Trouble(kind_of="always_killed")
    model.name = "trouble"
    with Processes(workers=2, retries=0) as executor:
        executor.start(model, {"name": "trouble", "kind_of": "always_killed"})
        wait = executor.submit(model, Batch(belief.ensemble.members, belief.memory, 1.0, Streams(4).members("e", 0)))
        for _ in range(2):  # asking again does not hang
            with pytest.raises(ComputationError, match="at most 0 are replaced"):
                wait()


def test_a_model_made_in_python_is_refused_by_executors_that_would_have_to_make_it_again():
    with pytest.raises(ConfigurationError, match=r"a package registers, got model 'Growth'.*use the executor 'serial'"):
        Processes(workers=1).start(Growth(), None)


def test_nothing_of_the_truth_can_be_reached():
    parts, _ = flown(1)
    held = {name: getattr(parts.rerun, name) for name in vars(parts.rerun)}
    assert parts.truth not in held.values() and len(held) == 3


def test_members_of_another_state_are_refused():
    parts, _ = flown(1)
    space = StateSpace([Variable("gas", 4)])
    with pytest.raises(ContractError, match=r"model 'Counting': a re-run needs members \(N, 5\), got \(2, 4\)"):
        parts.rerun(Ensemble(np.zeros((2, 4)), space), 0, 1)


@dataclass
class Restart(Filter):
    """Shifts the first guess by the last innovation, runs it again, and returns revised beliefs."""

    window: int | None = None

    def analyse_window(self, window, rng):
        missed = window.observation.values.mean() - window.predicted.mean()
        start = window.first.ensemble
        moved = start.with_members(start.members + 0.1 * missed * rng.standard_normal((len(start), 1)))
        numbers = [cycle.number for cycle in window.cycles]
        replay = window.rerun(moved, numbers[0], numbers[-1] + 1, keep=True)
        revised = dict(zip(numbers[1:], replay.states[:-1], strict=True))
        return Analysis(replay.forecast.ensemble.members, revised=revised, model_memory=replay.forecast.memory)


def test_a_filter_that_runs_the_model_again_has_the_same_bits_on_every_executor(tmp_path):
    files = {}
    for name in ("serial", "processes", "dask"):
        executor = registry().create("executor", {"name": name} | ({} if name == "serial" else {"workers": 2}))
        model, truth = (LinearAdvection(cells=20, length=20.0, error_sd=0.1) for _ in range(2))
        study = Study(
            model=model, truth=truth, filter=Restart(), observer=Grid(stride=5), executor=executor, members=5, cycles=4,
            record="all",
        )  # fmt: skip
        with dafw.run(study, tmp_path / name) as run:
            files[name] = {key: run[key].values.tobytes() for key in run.data_vars if key != "phase_seconds"}
    assert "u_smoothed_mean" in files["serial"]
    assert files["serial"] == files["processes"] == files["dask"]


class InPairs(Counting):
    """Makes two steps at once, or as many as it is told to."""

    given = 2

    def steps_with_memory(self, members, memory, t, rng, n_steps):
        steps = []
        for number in range(min(self.given, n_steps) if self.given == 2 else self.given):
            step = self.step_with_memory(members, memory, t + number * self.dt, rng.later(number))
            steps.append(step)
            members, memory = step.members, step.memory
        return steps


@pytest.mark.parametrize("last", [1, 2, 5])
def test_steps_that_a_model_makes_together_are_those_of_single_steps(last):
    single, pairs = (cls(spread=0.5, noise=0.1) for cls in (Counting, InPairs))
    guess = single.first_guess(3, Streams(5).members("initial", 0))
    operators = dict.fromkeys(range(last), TWO_NODES)
    one, two = (
        Rerun(model, Serial(), Streams(5))(guess, 0, last, operators=operators, keep=True) for model in (single, pairs)
    )
    assert len(one.states) == len(two.states) == last
    for a, b in zip(one.states, two.states, strict=True):
        assert a.ensemble.members.tobytes() == b.ensemble.members.tobytes()
        assert a.ensemble.time == b.ensemble.time
    assert one.stacked().tobytes() == two.stacked().tobytes()


@pytest.mark.parametrize("given", [0, 4])
def test_a_model_that_returns_no_step_or_too_many_is_refused(given):
    model = InPairs()
    model.given = given
    guess = model.first_guess(3, Streams(5).members("initial", 0))
    with pytest.raises(ContractError, match=rf"steps_with_memory must return 1 to 3 steps, got {given}"):
        Rerun(model, Serial(), Streams(5))(guess, 0, 3)
