"""A wind that changes in time: its value at known times, what it does to the gas, the same bits again."""

from __future__ import annotations

import numpy as np
import pytest
from run_files import contents
from small_study import CERTAIN, small_study

from dafw import ConfigurationError
from dafw.core.errors import ReadingsError
from dafw.core.rng import Streams
from dafw.plugins.models.dispersion.model import AdvectionDiffusion
from dafw.plugins.models.dispersion.model_ins import AdvectionDiffusionINS
from dafw.plugins.models.dispersion.wind_change import WindChange, WindChangeOptions
from dafw.plugins.models.wind_record import WindColumns
from dafw.studies.running import run_study

SMOOTH = {"kind": "smooth", "knots": 3, "spacing": 10.0}
PRESCRIBED = {"kind": "prescribed", "veer": 0.3, "duration": 60.0, "gust": 0.2, "period": 40.0}
LEAK = {"kind": "leak", "rate": 0.05, "start": 1.5}


def first_guess(model, n_members=3):
    return model.first_guess(n_members, Streams(3).members("initial", 0))


def wind_at(options, t, numbers=None, speed=5.0, direction=1.0):
    """Return speed and direction at a time; ``numbers`` are those of a smooth change, by name."""
    state = {name: np.array([[value]]) for name, value in (numbers or {}).items()}
    measured = WindColumns(**options.get("measured", {}))
    change = WindChange(WindChangeOptions(**options | {"measured": measured}))
    return tuple(part.item() for part in change.wind(t, np.array([speed]), np.array([direction]), state))


def numbers(speeds, directions):
    named = {f"wind_speed_change_{i}": value for i, value in enumerate(speeds, 1)}
    return named | {f"wind_direction_change_{i}": value for i, value in enumerate(directions, 1)}


def test_the_smooth_change_is_nothing_at_first_and_goes_through_its_numbers():
    given = numbers([0.1, -0.2, 0.3], [0.5, -0.4, 0.2])
    assert wind_at(SMOOTH, 0.0, given) == pytest.approx((5.0, 1.0))
    for i, (speed, direction) in enumerate(zip([0.1, -0.2, 0.3], [0.5, -0.4, 0.2], strict=True), 1):
        assert wind_at(SMOOTH, 10.0 * i, given) == pytest.approx((5.0 * np.exp(speed), 1.0 + direction))


def test_numbers_in_proportion_to_time_change_the_wind_linearly_until_the_last():
    given = numbers([0.1, 0.2, 0.3], [0.2, 0.4, 0.6])
    for t in (3.7, 12.0, 25.5):
        assert wind_at(SMOOTH, t, given) == pytest.approx((5.0 * np.exp(0.01 * t), 1.0 + 0.02 * t))
    assert wind_at(SMOOTH, 80.0, given) == pytest.approx((5.0 * np.exp(0.3), 1.6))  # held


def test_a_smooth_change_is_the_natural_cubic_spline():
    # Through (0, 0), (1, 1), (2, 0) its first piece is 1.5 t - 0.5 t^3.
    options = {"kind": "smooth", "knots": 2, "spacing": 1.0, "speed_sd": 0.0}
    given = numbers([], [1.0, 0.0])
    for t in (0.25, 0.5, 0.75):
        assert wind_at(options, t, given, direction=2.0)[1] == pytest.approx(2.0 + 1.5 * t - 0.5 * t**3)


def test_a_single_number_changes_the_wind_linearly_and_directions_stay_within_a_turn():
    options = {"kind": "smooth", "knots": 1, "spacing": 20.0, "speed_sd": 0.0}
    assert wind_at(options, 5.0, numbers([], [1.0]), direction=6.2) == pytest.approx((5.0, 6.45 - 2.0 * np.pi))


def test_a_prescribed_veer_reaches_its_end_and_gusts_their_amplitude():
    assert wind_at(PRESCRIBED, 0.0) == (5.0, 1.0)
    assert wind_at(PRESCRIBED, 10.0) == pytest.approx((5.0 * 1.2, 1.05))
    assert wind_at(PRESCRIBED, 30.0) == pytest.approx((5.0 * 0.8, 1.15))
    assert wind_at(PRESCRIBED, 60.0)[1] == wind_at(PRESCRIBED, 200.0)[1] == pytest.approx(1.3)


def test_a_wind_may_be_held_for_a_while():
    held = PRESCRIBED | {"every": 4.0}
    for t, middle in ((0.5, 2.0), (3.5, 2.0), (4.5, 6.0), (7.9, 6.0), (61.0, 62.0)):
        assert wind_at(held, t) == wind_at(PRESCRIBED, middle)


@pytest.fixture
def recorded(tmp_path):
    """Return a maker of the options of a wind measured every second from -20 to 60 s."""

    def make(speed, direction, **changes):
        time = np.arange(-20.0, 61.0)
        u, v = speed(time) * np.cos(direction(time)), speed(time) * np.sin(direction(time))
        rows = zip(time, np.broadcast_to(u, time.shape), np.broadcast_to(v, time.shape), strict=True)
        text = "".join(f"{t},{east:.17g},{north:.17g}\n" for t, east, north in rows)
        (tmp_path / "wind.csv").write_text("time,wind_x,wind_y\n" + text, encoding="utf-8")
        return {"kind": "measured", "measured": {"file": str(tmp_path / "wind.csv")}, **changes}

    return make


def test_a_measured_wind_is_followed_from_the_wind_at_the_start(recorded):
    turning = recorded(lambda t: 4.0 + 0.05 * t, lambda t: 0.0 * t + 2.0)
    assert wind_at(turning, 0.0) == pytest.approx((5.0, 1.0))
    assert wind_at(turning, 30.0) == pytest.approx((5.0 * 5.5 / 4.0, 1.0))  # linear, so equal to its mean
    gentle = recorded(lambda t: 4.0 + 0.0 * t, lambda t: 2.0 + 0.002 * t, average=4.0)
    assert wind_at(gentle, 50.0) == pytest.approx((5.0, 1.1))


def test_a_measured_wind_is_averaged_and_may_be_held(recorded):
    gust = recorded(lambda t: np.where(t < 10.0, 3.0, 6.0), lambda t: 0.0 * t, average=20.0)
    # Linear between the samples of 9 and 10 s; the window from -5 to 15 s has 14 s of 3, 1 s of 4.5 and 5 s of 6 m/s.
    assert wind_at(gust, 5.0, speed=1.0) == pytest.approx(((14 * 3.0 + 4.5 + 5 * 6.0) / (19 * 3.0 + 4.5), 1.0))
    held = gust | {"average": 2.0, "every": 20.0}
    # 9 s of 3, 1 s of 4.5, 10 s of 6 m/s; at t = 0 it is 3 m/s.
    for t in (1.0, 19.0):
        assert wind_at(held, t, speed=1.0) == pytest.approx(((9 * 3.0 + 4.5 + 10 * 6.0) / 20.0 / 3.0, 1.0))


def test_a_measured_wind_can_be_the_first_guess_and_carries_the_gas(small_site, recorded):
    """The centre of the gas travels as far as the wind's integral says, with the first wind off by a known factor."""
    wind = recorded(lambda t: 2.0 + 0.1 * t, lambda t: 2.8 + 0.03 * t, average=1.0)
    bell = {"mesh": {"wall_size": 4.0, "far_size": 4.0}, "transport": {"diffusion": 2.0}, "release_radius": 6.0}
    model = AdvectionDiffusion.from_options(
        site=small_site, **bell, wind_speed=None, wind_direction=None, wind_change=wind
    )
    members = np.array(first_guess(model, 1).ensemble.members)
    state, matrices = model.space.unpack(members), model._transport.matrices
    assert state["wind_speed"].item() == pytest.approx(2.0, abs=1e-3)
    assert state["wind_direction"].item() == pytest.approx(2.8, abs=1e-3)
    state["wind_speed"][:] *= 1.1
    part = model.space.slice("concentration")

    def centre():
        weight = matrices.before @ members[0, part]
        return weight @ model.space["concentration"].coordinates / weight.sum()

    before = centre()
    for second in range(4):
        members = model.step_with_memory(members, None, float(second), None).members
    times = np.linspace(0.0, 4.0, 4001)
    direction = 2.8 + 0.03 * times
    along = 1.1 * (2.0 + 0.1 * times) * np.array([np.cos(direction), np.sin(direction)])
    np.testing.assert_allclose(centre() - before, np.trapezoid(along, times, axis=1), atol=5e-3)
    assert any("at t = 0 2.00 m/s towards 2.80 radians" in note for note in model.notes())


def test_holding_a_wind_does_not_change_the_first_guess(small_model, recorded):
    wind = recorded(lambda t: 4.0 + 0.05 * t, lambda t: 0.3 + 0.01 * np.abs(t), average=2.0)
    models = [
        AdvectionDiffusion.from_options(**small_model | {"wind_speed": None}, wind_change=wind | more)
        for more in ({}, {"every": 30.0})
    ]
    assert models[0].first_wind == models[1].first_wind


def test_times_that_do_not_reach_the_start_are_refused(small_model, recorded):
    late = recorded(lambda t: 4.0 + 0.0 * t, lambda t: 0.0 * t)
    late["measured"]["start"] = -100.0
    with pytest.raises(
        ConfigurationError, match=r"its times, from 80 to 160 s, do not reach t = 0; set measured.start"
    ):
        AdvectionDiffusion.from_options(**small_model | {"wind_speed": None}, wind_change=late)


def test_a_calm_at_the_start_is_refused(small_model, recorded):
    calm = recorded(lambda t: 0.02 * np.abs(t), lambda t: 0.0 * t, average=2.0)
    with pytest.raises(ConfigurationError, match=r"which must be 0.5 m/s or more, got 0.0"):
        AdvectionDiffusion.from_options(**small_model | {"wind_speed": None}, wind_change=calm)


def test_the_centre_of_the_gas_travels_with_the_wind_of_the_middle_of_each_step(small_site):
    bell = {"mesh": {"wall_size": 4.0, "far_size": 4.0}, "transport": {"diffusion": 2.0}, "release_radius": 6.0}
    model = AdvectionDiffusion.from_options(
        site=small_site, **bell, wind_speed=2.0, wind_direction=2.8, wind_change=PRESCRIBED | {"duration": 4.0}
    )
    matrices, part = model._transport.matrices, model.space.slice("concentration")
    members = np.array(first_guess(model, 1).ensemble.members)

    def centre():
        weight = matrices.before @ members[0, part]
        return weight @ model.space["concentration"].coordinates / weight.sum()

    before, path = centre(), np.zeros(2)
    for second in range(4):
        members = model.step_with_memory(members, None, float(second), None).members
        speed = 2.0 * (1.0 + 0.2 * np.sin(2.0 * np.pi * (second + 0.5) / 40.0))
        direction = 2.8 + 0.3 * (second + 0.5) / 4.0
        path += speed * np.array([np.cos(direction), np.sin(direction)])
    # Exact for Galerkin's scheme, but for what little gas reaches the rim.
    np.testing.assert_allclose(centre() - before, path, atol=1e-7)


def test_a_smooth_change_is_part_of_the_state_with_its_priors(small_model):
    plain = AdvectionDiffusion.from_options(**small_model, estimate=["diffusion"])
    model = AdvectionDiffusion.from_options(
        **small_model,
        estimate=["diffusion"],
        wind_change=SMOOTH | {"direction_sd": 0.3},
        priors={"wind_speed_change_2": {"name": "uniform", "low": 0.5, "high": 0.6}},
    )
    names = [*numbers([0.0] * 3, [0.0] * 3)]
    assert [variable.name for variable in model.space.variables[4:]] == names
    members = first_guess(model, 200).ensemble.members
    state = model.space.unpack(members)
    spreads = [state[name].std() for name in names]
    np.testing.assert_allclose(spreads, [0.1, 0.1 / np.sqrt(12.0), 0.1, 0.3, 0.3, 0.3], rtol=0.2)
    assert state["wind_speed_change_2"].min() >= 0.5
    assert np.isfinite(model.log_first_guess(members)).all()
    np.testing.assert_array_equal(
        first_guess(plain, 200).ensemble.members, members[:, : plain.space.size]
    )  # the other numbers keep their draws
    certain = AdvectionDiffusion.from_options(**small_model, wind_change=SMOOTH, certain=True)
    assert (first_guess(certain).ensemble.members[:, certain.space.slice(names[0]).start :] == 0.0).all()


def test_a_change_that_is_zero_for_all_members_changes_nothing(small_model):
    plain = AdvectionDiffusionINS.from_options(**small_model)
    model = AdvectionDiffusionINS.from_options(**small_model, wind_change=SMOOTH, certain=True)
    for made in (plain, model):
        made.wind_speed_sd = made.wind_direction_sd = 0.0
    guesses = [first_guess(made, 2) for made in (plain, model)]
    rng = Streams(3).members("error", 0)
    fields = []
    for made, guess in zip((plain, model), guesses, strict=True):
        members = np.array(guess.ensemble.members)
        state = made.space.unpack(members)
        state["wind_speed"][:], state["wind_direction"][:] = 3.0, 3.0
        step = made.step_with_memory(members, guess.memory, 0.0, rng)
        fields.append(made.space.unpack(step.members)["concentration"])
    np.testing.assert_array_equal(*fields)


def test_the_steady_wind_is_solved_in_every_step_in_which_it_changes(small_model):
    model = AdvectionDiffusionINS.from_options(
        **small_model, wind_change={"kind": "prescribed", "veer": 0.02, "duration": 2.0}
    )
    forecast = first_guess(model, 2)
    start = model.space.unpack(forecast.ensemble.members)["wind_direction"][:, 0]
    for cycle, (turned, solved) in enumerate([(0.005, True), (0.015, True), (0.02, True), (0.02, False)]):
        forecast = model.forecast(forecast.ensemble, forecast.memory, Streams(3).members("error", cycle))
        np.testing.assert_allclose(forecast.memory["direction"], start + turned)
        assert forecast.diagnostics["wind_solved"].values.tolist() == [solved, solved]


@pytest.fixture(scope="module")
def study(small_model):
    """Return a maker of studies in which a leak and a changing wind are estimated; the truth's change is prescribed."""

    def make(executor="serial", **changes):
        model = small_model | {"wind_change": SMOOTH | {"spacing": 2.0}, "source": LEAK}
        model |= {"estimate": ["rate", "leak_start"]}
        truth = {"certain": True, "wind_change": PRESCRIBED, "wind_speed": 4.0}
        free = CERTAIN | {"certain": True}
        return small_study(model, truth, {"name": executor}, free=free, members=4, cycles=5, **changes)

    return make


def test_processes_give_the_same_bits(study, tmp_path):
    for executor in ("serial", "processes"):
        run_study(study(executor), tmp_path / executor)
    assert contents(tmp_path / "serial") == contents(tmp_path / "processes")


def test_a_re_run_repeats_the_belief(study):
    from dafw import advance

    parts, first = study(filter={"name": "none"}).begin()
    state = first
    for _ in range(5):
        state = advance(parts, state).state
    replay = parts.rerun(first.belief, 0, 5)
    np.testing.assert_array_equal(replay.forecast.ensemble.members, state.belief.ensemble.members)
    np.testing.assert_array_equal(replay.forecast.memory["unit"], state.belief.memory["unit"])
    settled = parts.rerun.settled(first.belief.ensemble)
    np.testing.assert_array_equal(settled.members, first.belief.ensemble.members)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"veer": 0.2}, "'veer' belongs to kind 'prescribed', .*choose kind=prescribed, or veer=0"),
        (SMOOTH | {"gust": 0.2}, "'gust' belongs to kind 'prescribed', and the kind is 'smooth'"),
        (SMOOTH | {"speed_sd": 0.0, "direction_sd": 0.0}, "both 0, so nothing changes: choose kind=none"),
        ({"kind": "prescribed", "gust": 1.5}, "option 'gust' must be at most 1"),
        ({"kind": "measured"}, "measured.file and kind=measured belong together, got kind=measured and the file ''"),
        ({"measured": {"file": "wind.csv"}}, "belong together, got kind=none and the file 'wind.csv'"),
    ],
)
def test_what_makes_no_sense_is_refused(small_model, options, message):
    with pytest.raises(ConfigurationError, match=message):
        AdvectionDiffusion.from_options(**small_model, wind_change=options)


@pytest.mark.parametrize("make", [AdvectionDiffusion, AdvectionDiffusionINS])
def test_a_wind_that_cannot_be_read_is_refused_before_a_run(small_model, make):
    wind = {"kind": "measured", "measured": {"file": "nowhere.csv"}}
    with pytest.raises(ReadingsError, match=r"nowhere.csv: not found"):
        make.from_options(**small_model, wind_change=wind).require_available()


def test_a_model_says_from_which_files_its_wind_comes(small_model, recorded):
    assert AdvectionDiffusion.from_options(**small_model).input_files == []
    wind = recorded(lambda t: 4.0 + 0.0 * t, lambda t: 0.0 * t)
    model = AdvectionDiffusion.from_options(**small_model, wind_change=wind)
    assert [str(path) for path in model.input_files] == [wind["measured"]["file"]]


def test_only_a_measured_wind_can_take_the_place_of_a_number(small_model):
    with pytest.raises(ConfigurationError, match="wind_direction is null, which means the measured one: set wind_ch"):
        AdvectionDiffusion.from_options(**small_model | {"wind_direction": None})
