"""The belief run ahead: exact times and doses, weights, and nothing that is disturbed."""

from dataclasses import replace

import numpy as np
import pytest
from toys import AIRSPACE, Growth, Nudge, toy_parts

from dafw import Analysis, ForecastPlan, Vehicle
from dafw.core.cycle import advance, start
from dafw.core.ensemble import Forecast
from dafw.core.executors.processes import Processes
from dafw.core.executors.serial import Serial
from dafw.core.forecasts.ahead import AT_ONCE, belief_ahead, free_ahead, run_ahead, truth_ahead
from dafw.core.forecasts.areas import places_of
from dafw.core.forecasts.forecast_file import told_of
from dafw.core.registry import registry
from dafw.plugins.models.lorenz96 import Lorenz96

VEHICLE = Vehicle(np.zeros((1, 2)), speed=1.0, dt=2.0, airspace=AIRSPACE)
PLAN = ForecastPlan(every=2.0, horizon=8.0, lead_times=[0.0, 4.0, 8.0], thresholds=[3.5, 1.0, 50.0])
"""In order the thresholds are 1, 3.5 and 50."""


def places(parts):
    return places_of(PLAN, parts.model.space.variables[0], parts.model.domain)


def begun(**changes):
    parts = toy_parts(**changes)
    return parts, start(parts, 3, VEHICLE)


def bits(state):
    parts = [state.belief.ensemble.members, state.truth.ensemble.members, state.free.ensemble.members]
    return b"".join(part.tobytes() for part in parts) + state.vehicle.positions.tobytes()


def test_times_and_doses_of_a_field_that_grows_are_exact():
    # Gas is 1 at the start and grows by the rate, here 1, in every step of 2 s: 1, 2, 3, 4, 5.
    parts, state = begun(model=Growth(rate=1.0))
    course = belief_ahead(parts, state, PLAN, places(parts)).nodes
    assert course.values.shape == (3, 3, 4) and course.arrival.shape == (3, 3, 4)
    np.testing.assert_allclose(course.values[:, 0, 0], [1.0, 3.0, 5.0])
    np.testing.assert_allclose(course.arrival[:, 0, 0], [2.0, 6.0, np.inf])  # 1 does not exceed 1
    np.testing.assert_allclose(course.clearing[:, 0, 0], [np.inf, np.inf, 0.0])  # still above, and never above
    np.testing.assert_allclose(course.dose, 2.0 * (0.5 + 2.0 + 3.0 + 4.0 + 2.5))


def test_a_field_that_shrinks_clears():
    parts, state = begun(model=Growth(rate=-0.75))
    high = state.belief.ensemble.with_members(state.belief.ensemble.members + np.array([4.0, 4.0, 4.0, 4.0, 0.0]))
    # 5, 4.25, 3.5, 2.75, 2
    course = belief_ahead(parts, _with(state, high), PLAN, places(parts)).nodes
    np.testing.assert_allclose(course.arrival[:, 0, 0], [0.0, 0.0, np.inf])
    np.testing.assert_allclose(course.clearing[:, 0, 0], [np.inf, 4.0, 0.0])


def _with(state, ensemble):
    return replace(state, belief=Forecast(ensemble, state.belief.memory))


def test_weights_are_respected():
    parts, state = begun(model=Growth(rate=1.0))
    members = state.belief.ensemble.members.copy()
    members[:, 4] = [0.0, 1.0, 2.0]  # values after 8 s: 1, 5, 9
    weighted = state.belief.ensemble.with_members(members, [0.2, 0.3, 0.5])
    course = belief_ahead(parts, _with(state, weighted), PLAN, places(parts)).nodes
    told = told_of(course, PLAN, "gas")
    np.testing.assert_allclose(told["exceedance_probability"][2, :, 0], [0.8, 0.8, 0.0])
    np.testing.assert_allclose(told["reach_probability"][:, 0], [0.8, 0.8, 0.0])
    # Thresholds 1 and 3.5 are exceeded after 2 and 6 s by the second member, after 2 and 4 s by the third.
    np.testing.assert_allclose(told["arrival_time"][1, :, 0], [4.0, 4.0, np.nan])
    np.testing.assert_allclose(told["gas_exceeded"][2, :, 0], [9.0, 9.0, 1.0])
    doses = 8.0 * (1.0 + 2.0 * members[:, 4])
    np.testing.assert_allclose(told["dose_mean"][0], doses @ [0.2, 0.3, 0.5])


def test_looking_ahead_disturbs_nothing():
    results = []
    for looks in (False, True):
        parts, state = begun()
        for _ in range(4):
            if looks:
                run_ahead(parts, state, PLAN, places(parts))
            state = advance(parts, state).state
        results.append(bits(state))
    assert results[0] == results[1]


def test_the_truth_and_the_free_run_are_those_that_come():
    parts, state = begun(truth=Growth(rate=2.0, noise=0.3), free=Growth(noise=0.2))
    state = advance(parts, state).state
    truth, free = (ahead(parts, state, PLAN, places(parts)) for ahead in (truth_ahead, free_ahead))
    for _ in range(4):
        state = advance(parts, state).state
    np.testing.assert_array_equal(truth.nodes.values[2, 0], state.truth.ensemble.members[0, :4])
    np.testing.assert_array_equal(free.nodes.values[2, 0], state.free.ensemble.members[0, :4])


def test_the_members_have_errors_of_their_own_not_those_that_come():
    parts, state = begun(filter=_Blind())
    ahead = belief_ahead(parts, state, PLAN, places(parts))
    for _ in range(4):
        state = advance(parts, state).state
    assert not np.array_equal(ahead.nodes.values[2], state.belief.ensemble.members[:, :4])


class _Blind(Nudge):
    def analyse(self, forecast, predicted, observation, rng):
        return Analysis(forecast.members)


def test_a_long_horizon_is_run_in_pieces_with_the_same_bits():
    parts, state = begun()
    n_cycles = 2 * AT_ONCE + 3
    plan = ForecastPlan(every=2.0, horizon=2.0 * n_cycles, lead_times=[2.0 * n_cycles], thresholds=[1.0])
    pieces = belief_ahead(parts, state, plan, places(parts)).nodes.values[-1]
    whole = parts.rerun(state.belief, 0, n_cycles, role="planning").forecast.ensemble.members[:, :4]
    assert pieces.tobytes() == whole.tobytes()


def test_worker_processes_give_the_same_forecast():
    model, plan = Lorenz96(size=8), ForecastPlan(horizon=0.5, lead_times=[0.5], thresholds=[2.0])
    found = []
    for executor in (Serial(), Processes(workers=2)):
        parts = toy_parts(model=model, truth=None, free=None, executor=executor)
        with executor:
            executor.start(model, registry().recipe(model))
            state = start(parts, 5, VEHICLE)
            where = places_of(plan, model.space.variables[0], model.domain)
            found.append(belief_ahead(parts, state, plan, where).nodes)
    assert found[0].values.tobytes() == found[1].values.tobytes()


@pytest.mark.parametrize("verify", [True, False])
def test_only_a_plan_that_verifies_runs_the_truth(verify):
    parts, state = begun()
    _, singles = run_ahead(parts, state, replace(PLAN, verify=verify), places(parts))
    assert set(singles) == ({"truth", "free"} if verify else set())
