"""The dispersion models: order of a step, thresholds, memory, winds that cannot be solved."""

import numpy as np
import pytest

from dafw import ConfigurationError, SolverError
from dafw.core.options import build
from dafw.core.rng import Streams
from dafw.plugins.models.dispersion.model import AdvectionDiffusion
from dafw.plugins.models.dispersion.model_ins import AdvectionDiffusionINS
from dafw.plugins.models.dispersion.wind.solution import WindError

STREAMS = Streams(4)


def make(options, cls=AdvectionDiffusionINS, **changes):
    return build(cls, options | changes, "model 'test'")


def begin(model, n_members=3):
    return model.first_guess(n_members, STREAMS.members("initial", 0))


def step(model, forecast, cycle=0):
    return model.forecast(forecast.ensemble, forecast.memory, STREAMS.members("error", cycle))


def with_wind(model, forecast, speed=None, direction=None):
    """Return the forecast with other winds, as after an analysis."""
    members = forecast.ensemble.members.copy()
    state = model.space.unpack(members)
    if speed is not None:
        state["wind_speed"][:, 0] = speed
    if direction is not None:
        state["wind_direction"][:, 0] = direction
    return type(forecast)(type(forecast.ensemble)(members, model.space, forecast.ensemble.time), forecast.memory)


@pytest.fixture(scope="module")
def model(small_model):
    return make(small_model)


def test_the_release_is_a_bell_of_height_one_the_same_in_all_members(model):
    state = model.space.unpack(begin(model).ensemble.members)
    nodes = model.space["concentration"].coordinates
    distance = np.hypot(*(nodes - [50.0, 0.0]).T)
    np.testing.assert_allclose(state["concentration"], np.exp(-(distance**2) / (2 * 15.0**2))[None].repeat(3, 0))
    assert len(np.unique(state["wind_speed"])) == 3 == len(np.unique(state["wind_direction"]))


def test_the_wind_is_solved_at_first_and_then_only_past_the_thresholds(model):
    first = step(model, begin(model))
    assert first.diagnostics["wind_solved"].values.all()
    assert not step(model, first).diagnostics["wind_solved"].values.any()
    speed = model.space.unpack(first.ensemble.members)["wind_speed"][:, 0]
    direction = model.space.unpack(first.ensemble.members)["wind_direction"][:, 0]
    # |I - I_INS| >= 0.10 |I| with I the new speed
    faster = with_wind(model, first, speed=speed * np.array([1.10, 1.12, 0.92]))
    assert step(model, faster).diagnostics["wind_solved"].values.tolist() == [False, True, False]
    turned = with_wind(model, first, direction=direction * np.array([1.02, 1.06, 0.93]))
    assert step(model, turned).diagnostics["wind_solved"].values.tolist() == [False, True, True]


def test_direction_thresholds_compare_wrapped_differences(model):
    memory = {"speed": np.full(2, 3.0), "direction": np.array([0.01, 6.27])}
    # the direction on the other side of 0 = 2 pi is 0.04 away, within 5 % of 6.27 but not of 0.026
    due = model.due(np.full(2, 3.0), np.array([6.27, 0.026]), memory)
    assert due.tolist() == [False, True]


def test_the_gas_is_carried_by_the_wind_of_the_last_solve(model):
    first = step(model, begin(model))
    nudged = with_wind(model, first, speed=model.space.unpack(first.ensemble.members)["wind_speed"][:, 0] * 1.05)
    one, other = step(model, first), step(model, nudged)
    part = model.space.slice("concentration")
    np.testing.assert_array_equal(one.ensemble.members[:, part], other.ensemble.members[:, part])


def test_the_wind_parameters_do_not_evolve(model):
    before = begin(model)
    after = step(model, before)
    for name in ("wind_speed", "wind_direction"):
        part = model.space.slice(name)
        np.testing.assert_array_equal(before.ensemble.members[:, part], after.ensemble.members[:, part])


def test_results_do_not_depend_on_what_else_ran(small_model):
    fresh, used = make(small_model), make(small_model)
    step(used, with_wind(used, begin(used), speed=6.0, direction=1.0))
    a, b = step(fresh, begin(fresh)), step(used, begin(used))
    np.testing.assert_array_equal(a.ensemble.members, b.ensemble.members)
    np.testing.assert_array_equal(a.memory["unit"], b.memory["unit"])


def test_members_stepped_in_batches_give_the_same_bits(small_model):
    model = make(small_model, noise=0.1)
    whole = begin(model, 4)
    together = step(model, whole)
    rng = STREAMS.members("error", 0)
    for first, last in ((0, 1), (1, 4)):
        memory = {name: array[first:last] for name, array in whole.memory.items()}
        part = model.step_with_memory(whole.ensemble.members[first:last], memory, 0.0, rng.shifted(first))
        np.testing.assert_array_equal(part.members, together.ensemble.members[first:last])


def test_noise_has_the_size_of_the_value_and_spurious_values_are_cut(small_model):
    quiet = make(small_model, noise=0.0, cutoff=1e-6)
    noisy = make(small_model, noise=0.1, cutoff=0.05)
    part = quiet.space.slice("concentration")
    start = begin(quiet)
    drawn = STREAMS.members("error", 0).standard_normal((3, part.stop))
    members = start.ensemble.members.copy()
    members[:, part] *= 1.0 + 0.1 * drawn
    members[:, part][members[:, part] <= 0.05] = 0.0
    by_hand = type(start)(type(start.ensemble)(members, quiet.space), start.memory)
    expected, got = step(quiet, by_hand), step(noisy, begin(noisy))
    np.testing.assert_allclose(got.ensemble.members, expected.ensemble.members, rtol=1e-12, atol=1e-15)


HARD = {"viscosity": 1e-5, "max_steps": 2, "max_iterations": 3}


def test_a_wind_that_cannot_be_solved_stops_the_run_and_names_the_member(small_model):
    hopeless = make(small_model, wind=HARD)
    with pytest.raises(SolverError, match=r"member 0: .*intensity.*direction.*viscosity.*residual"):
        step(hopeless, begin(hopeless))


def test_or_the_last_good_one_is_kept_and_that_is_recorded(small_model, monkeypatch):
    model = make(small_model, on_unsolved="keep")
    first = step(model, begin(model))
    solve = model.solver.solve

    def fail_for_one(intensity, direction, *others):
        if intensity == 9.0:
            raise WindError("no luck")
        return solve(intensity, direction, *others)

    monkeypatch.setattr(model.solver, "solve", fail_for_one)
    gusty = with_wind(model, first, speed=np.array([9.0, 6.0, 7.0]))
    after = step(model, gusty)
    assert after.diagnostics["wind_kept"].values.tolist() == [True, False, False]
    assert after.diagnostics["wind_solved"].values.tolist() == [False, True, True]
    np.testing.assert_array_equal(after.memory["unit"][0], first.memory["unit"][0])
    np.testing.assert_array_equal(after.memory["speed"][1:], [6.0, 7.0])


def test_without_a_last_good_one_it_stops_all_the_same(small_model):
    hopeless = make(small_model, wind=HARD, on_unsolved="keep")
    with pytest.raises(SolverError, match="member 0"):
        step(hopeless, begin(hopeless))


def test_a_calm_member_is_carried_nowhere(small_model):
    # a bell narrow enough not to feel the zero at the rim
    calm = make(small_model, release_radius=6.0, wind_speed=0.0, wind_speed_sd=0.0, transport={"diffusion": 0.0})
    before = begin(calm, 1)
    after = step(calm, before)
    np.testing.assert_allclose(after.ensemble.members, before.ensemble.members, atol=1e-10)


def test_ad_carries_the_gas_at_the_speed_of_the_wind(small_site):
    options = {"site": small_site, "mesh": {"wall_size": 4.0, "far_size": 4.0, "transition": 1.0}}
    model = make(
        options, AdvectionDiffusion, release=[60.0, 45.0], release_radius=10.0, wind_speed=5.0, wind_direction=np.pi
    )
    forecast = begin(model, 1)
    nodes = model.space["concentration"].coordinates

    def centre(forecast):
        weight = model.space.unpack(forecast.ensemble.members)["concentration"][0]
        return weight @ nodes / weight.sum()

    before = centre(forecast)
    for cycle in range(4):
        forecast = step(model, forecast, cycle)
    # 4 s at 5 m/s towards the west; the nodal sum is a quadrature of a few per cent
    np.testing.assert_allclose(centre(forecast) - before, [-20.0, 0.0], atol=1.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"release": [0.0, 0.0]}, "lies in a building"), ({"release": [500.0, 0.0]}, "outside the site")],
)
def test_a_release_that_cannot_be_is_refused(small_model, changes, message):
    with pytest.raises(ConfigurationError, match=message):
        _ = make(small_model, **changes).domain
