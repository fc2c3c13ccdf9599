"""The viscosity as an unknown: a wind depends on direction and Reynolds number alone, so one basis serves."""

import numpy as np
import pytest

from dafw import ConfigurationError
from dafw.core.errors import ContractError
from dafw.core.options import build
from dafw.core.rng import Streams
from dafw.plugins.models.dispersion.model import AdvectionDiffusion
from dafw.plugins.models.dispersion.model_ins import AdvectionDiffusionINS

STREAMS = Streams(5)
REDUCED = {"solver": "reduced", "basis": {"directions": 8, "levels": 3, "max_intensity": 6.0, "modes": 30}}
FIXED = {"wind_speed_sd": 0.0, "wind_direction_sd": 0.0, "noise": 0.0}


@pytest.fixture(scope="module")
def make(small_model, tmp_path_factory):
    """Return a function that makes the small model with an unknown viscosity; the reduced bases have a cache."""

    def made(cls=AdvectionDiffusionINS, **changes):
        options = small_model | {"estimate": ["viscosity"]} | changes
        return build(cls, options, "model 'test'")

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DAFW_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield made


def guess(model, n_members=3):
    return model.first_guess(n_members, STREAMS.members("initial", 0))


def step(model, forecast):
    return model.forecast(forecast.ensemble, forecast.memory, STREAMS.members("error", 0))


def with_values(model, forecast, **values):
    """Return the forecast with other numbers in the state, as after an analysis."""
    members = forecast.ensemble.members.copy()
    state = model.space.unpack(members)
    for name, value in values.items():
        state[name][:, 0] = value
    return type(forecast)(type(forecast.ensemble)(members, model.space, forecast.ensemble.time), forecast.memory)


@pytest.mark.parametrize("wind", [{}, REDUCED], ids=["newton", "reduced"])
def test_half_the_speed_and_half_the_viscosity_are_the_same_pattern(make, wind):
    solver = make(wind=wind).solver
    first = solver.solve(4.0, 0.7, viscosity=30.0)
    second = solver.solve(2.0, 0.7, viscosity=15.0)
    np.testing.assert_array_equal(first.unit, second.unit)
    np.testing.assert_array_equal(
        solver.velocity(first).x.array, 2.0 * solver.velocity(second).x.array, err_msg="the speed is a factor"
    )
    usual = solver.options.viscosity
    np.testing.assert_array_equal(solver.solve(4.0, 0.7).unit, solver.solve(4.0, 0.7, viscosity=usual).unit)
    assert not np.array_equal(first.unit, solver.solve(4.0, 0.7, viscosity=60.0).unit)


def test_a_wind_that_the_basis_does_not_have_is_solved_with_its_viscosity(make):
    solver = make(wind=REDUCED | {"viscosity": 25.0, "basis": REDUCED["basis"] | {"tolerance": 1e-12}}).solver
    full = make(wind={"viscosity": 25.0, "tolerance": 1e-10}).solver
    unit = solver.solve(4.0, 0.7, viscosity=12.5).unit
    assert not solver.trusts(unit)
    solver._full.clear()  # as in another process, where only the unit wind is known
    found, wanted = (velocity.x.array for velocity in (solver.velocity(unit, 4.0), full.velocity(full.solve(8.0, 0.7))))
    np.testing.assert_allclose(found, 0.5 * wanted, atol=1e-6 * np.abs(wanted).max())


def test_members_carry_their_own_viscosity_as_if_it_were_the_option(make):
    model = make(**FIXED)
    found = step(model, with_values(model, guess(model), viscosity=[20.0, 30.0, 60.0]))
    for member, viscosity in enumerate((20.0, 30.0, 60.0)):
        alone = make(**FIXED, estimate=[], wind={"viscosity": viscosity})
        wanted = step(alone, guess(alone, 1)).ensemble.members[0, alone.space.slice("concentration")]
        np.testing.assert_array_equal(found.ensemble.members[member, model.space.slice("concentration")], wanted)
    assert found.memory["viscosity"].tolist() == [20.0, 30.0, 60.0]


def test_a_wind_is_solved_again_if_its_viscosity_passes_the_threshold_of_the_speed(make):
    model = make()
    first = step(model, guess(model))
    now = first.memory["viscosity"]
    changed = with_values(model, first, viscosity=now * np.array([1.0, 1.09, 1.12]))
    assert step(model, changed).diagnostics["wind_solved"].values.tolist() == [False, False, True]


def test_the_first_guess_ends_where_the_basis_ends(make):
    model = make(wind=REDUCED | {"viscosity": 25.0}, wind_speed=4.0, wind_speed_sd=2.0)
    members = guess(model, 200).ensemble.members
    state = model.space.unpack(members)
    reynolds = state["wind_speed"][:, 0] / state["viscosity"][:, 0]
    assert 0.18 < reynolds.max() <= 6.0 / 25.0 and (state["wind_speed"] > 6.0).any()
    assert np.isfinite(model.log_first_guess(members)).all()
    beyond = members[:1].copy()
    model.space.unpack(beyond)["viscosity"][:] = state["wind_speed"][0] * 25.0 / 6.001
    assert model.log_first_guess(beyond)[0] == -np.inf
    free = make(wind={"viscosity": 25.0}, wind_speed=4.0, wind_speed_sd=2.0)
    assert np.isfinite(free.log_first_guess(beyond)).all(), "without a basis there is no such end"


def test_a_first_guess_that_is_all_but_impossible_says_so(make):
    model = make(wind=REDUCED | {"viscosity": 25.0}, priors={"viscosity": {"name": "point", "mean": 0.1}})
    with pytest.raises(ConfigurationError, match=r"model 'AdvectionDiffusionINS': of 1000 draws .* none is possible"):
        guess(model)


def test_what_cannot_be_estimated_is_refused(make):
    with pytest.raises(ConfigurationError, match="with the closure 'constant' only, got 'proportional'"):
        make(wind={"closure": "proportional"})
    with pytest.raises(ConfigurationError, match="'viscosity' cannot be estimated"):
        make(AdvectionDiffusion)
    with pytest.raises(ContractError, match="expected a finite viscosity above 0 m\\^2/s, got -1"):
        make().solver.solve(1.0, 0.0, viscosity=-1.0)


def test_a_truth_that_is_certain_has_the_viscosity_of_its_options(make):
    truth = make(certain=True, wind={"viscosity": 40.0})
    assert truth.space.unpack(guess(truth, 1).ensemble.members)["viscosity"].item() == 40.0
    other = make(certain=True, wind={"viscosity": 40.0, "closure": "proportional"})
    assert other.space.unpack(guess(other, 1).ensemble.members)["viscosity"].item() == 40.0
