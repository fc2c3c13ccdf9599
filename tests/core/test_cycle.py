"""The one time loop: order, reproducibility, restart, and errors that say where they happened."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from toys import Counting, Growth, Hop, Nudge, OneNode, toy_parts

from dafw import ComputationError, ConfigurationError, ContractError, Diagnostic, Domain, Filter, Route, Vehicle
from dafw.core.cycle import advance, start
from dafw.core.ensemble import Analysis
from dafw.core.rng import Streams

POST = np.array([[1.35, 1.35], [1.4, 1.35], [1.4, 1.4]])
VEHICLE = Vehicle(np.zeros((1, 2)), speed=1.0, dt=2.0, airspace=Domain((-50.0, -50.0, 50.0, 50.0), (POST,)))


def fly(parts, cycles, n_members=5, state=None):
    """Return the cycles and the state at the end."""
    state = state or start(parts, n_members, VEHICLE)
    done = []
    for _ in range(cycles):
        done.append(advance(parts, state))
        state = done[-1].state
    return done, state


def same(a, b):
    return all(
        np.array_equal(getattr(a, role).ensemble.members, getattr(b, role).ensemble.members)
        for role in ("belief", "truth", "free")
    )


def test_one_cycle_does_what_the_diagram_says():
    parts = toy_parts()
    before = start(parts, 5, VEHICLE)
    cycle = advance(parts, before)
    assert cycle.state.belief.ensemble.time == 2.0 == cycle.observation.time
    np.testing.assert_array_equal(cycle.state.truth.ensemble.members[0, :4], 3.0)
    np.testing.assert_array_equal(cycle.state.free.ensemble.members[0, :4], 2.0)
    np.testing.assert_array_equal(cycle.state.vehicle.positions, [[1.0, 0.0]])
    # the reading is of the truth after the step, with noise of 0.1
    assert 0.0 < abs(cycle.observation.values[0] - 3.0) < 0.6
    np.testing.assert_array_equal(cycle.predicted[:, 0], cycle.forecast.members[:, 0])
    shift = 0.5 * (cycle.observation.values[0] - cycle.predicted.mean())
    np.testing.assert_array_equal(cycle.state.belief.ensemble.members[:, :4], cycle.forecast.members[:, :4] + shift)


def test_the_same_seed_gives_the_same_bits_and_another_seed_others():
    (_, first), (_, again), (_, other) = (fly(toy_parts(seed), 4) for seed in (1, 1, 2))
    assert same(first, again) and not same(first, other)


def test_a_run_cut_anywhere_continues_to_the_same_bits():
    parts = toy_parts(model=Counting(spread=0.5, noise=0.1))
    _, whole = fly(parts, 6)
    for cut in range(1, 6):
        _, half = fly(parts, cut)
        _, rest = fly(toy_parts(model=Counting(spread=0.5, noise=0.1)), 6 - cut, state=pickle.loads(pickle.dumps(half)))
        assert same(whole, rest)
        np.testing.assert_array_equal(rest.belief.memory["steps"], 6.0)


def test_more_members_leave_the_draws_of_the_others_as_they_were():
    (small, _), (large, _) = fly(toy_parts(), 1, 4), fly(toy_parts(), 1, 9)
    np.testing.assert_array_equal(small[0].forecast.members, large[0].forecast.members[:4])
    np.testing.assert_array_equal(small[0].observation.values, large[0].observation.values)


def test_another_policy_meets_the_same_truth_and_the_same_noise():
    (east, a), (astray, b) = fly(toy_parts(), 5), fly(toy_parts(policy=Hop(random=True)), 5)
    np.testing.assert_array_equal(a.truth.ensemble.members, b.truth.ensemble.members)
    assert not np.array_equal(a.vehicle.positions, b.vehicle.positions)
    for one, other in zip(east, astray, strict=True):
        # all nodes of the toy truth are equal, so equal readings mean equal noise
        np.testing.assert_array_equal(one.observation.values, other.observation.values)


def test_the_policy_cannot_see_the_truth():
    (one, _), (other, _) = fly(toy_parts(), 1), fly(toy_parts(truth=Growth(rate=99.0)), 1)
    np.testing.assert_array_equal(one[0].route.paths[0], other[0].route.paths[0])


def test_the_filter_does_not_touch_the_free_run():
    (_, a), (_, b) = fly(toy_parts(), 3), fly(toy_parts(observer=FarAway()), 3)
    np.testing.assert_array_equal(a.free.ensemble.members, b.free.ensemble.members)
    assert not np.array_equal(a.belief.ensemble.members, b.belief.ensemble.members)


def test_a_study_needs_no_free_run():
    assert fly(toy_parts(free=None), 2)[1].free is None


class FarAway(OneNode):
    """An observer without readings."""

    def operator(self, space, route, t):
        full = super().operator(space, route, t)
        return replace(full, indices=full.indices[:0], covariance=full.covariance[:0])


def test_without_readings_the_forecast_is_the_analysis():
    cycles, _ = fly(toy_parts(observer=FarAway()), 2)
    np.testing.assert_array_equal(cycles[1].forecast.members, cycles[1].state.belief.ensemble.members)


class WrongShape(Growth):
    def step(self, members, t, rng):
        return members[:, :-1]


class NotANumber(Growth):
    def step(self, members, t, rng):
        return np.where(np.arange(5) == 3, np.nan, members)


class Mutating(Growth):
    def step(self, members, t, rng):
        members += 1.0
        return members


class Broken(Growth):
    def step(self, members, t, rng):
        raise RuntimeError("the pump failed")


class Teleporting(Hop):
    def decide(self, belief, vehicle, rng):
        return Route((np.array([[0.0, 0.0], [100.0, 0.0]]),))


class Forgetful(Hop):
    def decide(self, belief, vehicle, rng):
        return Route()


class Absent(Hop):
    def decide(self, belief, vehicle, rng):
        return Route((np.array([[5.0, 5.0]]),))


class ThroughTheWall(Hop):
    def decide(self, belief, vehicle, rng):
        return Route((np.array([[0.0, 0.0], [1.41, 1.41]]),))


class Chatty(Nudge):
    def analyse(self, forecast, predicted, observation, rng):
        return Analysis(forecast.members, diagnostics={"mood": Diagnostic("fine")})


class Miscounting(Nudge):
    def analyse(self, forecast, predicted, observation, rng):
        return Analysis(forecast.members, diagnostics={"gain": Diagnostic(np.ones(3), ("a", "b"))})


class Wordy(Nudge):
    def analyse(self, forecast, predicted, observation, rng):
        return Analysis(np.full(forecast.members.shape, "x"))


class Meddling(Nudge):
    def analyse(self, forecast, predicted, observation, rng):
        predicted[:] = 0.0
        return Analysis(forecast.members)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"model": WrongShape()}, ContractError, r"model 'WrongShape'.*shape \(5, 5\), got \(5, 4\)"),
        ({"model": NotANumber()}, ContractError, r"model 'NotANumber'.*holds nan at \(0, 3\)"),
        ({"model": Mutating()}, ComputationError, "model 'Mutating' raised ValueError.*read-only"),
        ({"model": Broken()}, ComputationError, "at t = 0 s, phase 'forecast': model 'Broken' raised.*pump failed"),
        ({"truth": Broken()}, ComputationError, "phase 'truth'"),
        ({"truth": NotANumber()}, ContractError, "phase 'truth': model 'NotANumber'.*holds nan"),
        ({"free": NotANumber()}, ContractError, "phase 'free': model 'NotANumber'.*holds nan"),
        ({"policy": Teleporting()}, ContractError, "policy 'Teleporting': vehicle 0 would fly 100 m, it can fly 2 m"),
        ({"policy": Forgetful()}, ContractError, "1 vehicles, but 0 paths"),
        ({"policy": Absent()}, ContractError, "does not begin at"),
        ({"policy": ThroughTheWall()}, ContractError, "vehicle 0 would fly out of the domain or into a building"),
        ({"filter": Chatty()}, ContractError, "filter 'Chatty': diagnostic 'mood' must hold numbers"),
        ({"filter": Miscounting()}, ContractError, "diagnostic 'gain'.*one of its dims"),
        ({"filter": Wordy()}, ContractError, "filter 'Wordy'.*real numbers"),
        ({"filter": Meddling()}, ComputationError, "filter 'Meddling' raised ValueError.*read-only"),
        ({"filter": Filter()}, ComputationError, "filter 'Filter' must define analyse"),
    ],
)
def test_a_broken_contract_is_named_with_time_phase_and_plugin(changes, error, message):
    with pytest.raises(error, match=message):
        fly(toy_parts(**changes), 1)


def test_too_few_members_are_refused_at_the_start():
    with pytest.raises(ConfigurationError, match="at least 2 members, the study has 1"):
        start(toy_parts(), 1, VEHICLE)


def test_streams_are_of_the_seed_alone():
    assert Streams(5).generator("a", 0).random() == Streams(5).generator("a", 0).random()
