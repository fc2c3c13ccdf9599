"""Numbers that a study estimates besides the wind are part of the state, with a prior; the others stay fixed."""

from __future__ import annotations

import numpy as np
import pytest

from dafw import POSITIVE, ConfigurationError, OptionError
from dafw.core.rng import Streams
from dafw.plugins.models.dispersion.model import AdvectionDiffusion

SMALL = AdvectionDiffusion.check_options()


def model(**options):
    return AdvectionDiffusion.from_options(**{**SMALL, "noise": 0.0, **options})


def guess(made, n_members=6):
    return made.first_guess(n_members, Streams(3).members("initial", 0)).ensemble


def test_nothing_more_than_the_wind_is_estimated_unless_it_is_asked_for():
    assert [variable.name for variable in model().space.variables] == ["concentration", "wind_speed", "wind_direction"]


def test_what_is_estimated_is_drawn_after_the_wind_which_keeps_its_draws():
    plain, more = model(), model(estimate=["amount", "diffusion"])
    assert [variable.name for variable in more.space.variables[3:]] == ["diffusion", "amount"]
    assert more.space["diffusion"].kind is POSITIVE and more.space["diffusion"].units == "m2 s-1"
    winds = [made.space.unpack(guess(made).members)["wind_speed"] for made in (plain, more)]
    np.testing.assert_array_equal(*winds)
    diffusion = more.space.unpack(guess(more, 40).members)["diffusion"]
    assert len(np.unique(diffusion)) == 40 and (diffusion > 0.0).all()


@pytest.mark.parametrize(("release_sd", "expected"), [(2.0, 2.0), (None, SMALL["release_radius"])])
def test_the_place_of_a_release_is_as_uncertain_as_the_option_says(release_sd, expected):
    made = model(estimate=["release_x", "release_y"], release_sd=release_sd)
    drawn = made.space.unpack(guess(made, 400).members)
    for name in ("release_x", "release_y"):
        assert drawn[name].std() == pytest.approx(expected, rel=0.15)  # four standard errors


def test_a_member_is_carried_with_its_own_diffusion():
    made = model(estimate=["diffusion"], wind_speed_sd=0.0, wind_direction_sd=0.0)
    start = guess(made, 3)
    members = np.array(start.members)
    members[:, made.space.slice("diffusion")] = [[0.1], [0.8], [3.0]]
    step = made.step_with_memory(members, None, 0.0, None).members
    for member, diffusion in enumerate((0.1, 0.8, 3.0)):
        fixed = model(transport={"diffusion": diffusion}, wind_speed_sd=0.0, wind_direction_sd=0.0)
        alone = fixed.step_with_memory(members[member : member + 1, : fixed.space.size], None, 0.0, None).members
        gas = made.space.slice("concentration")
        np.testing.assert_allclose(step[member, gas], alone[0, gas], rtol=0, atol=1e-10)


def test_the_cloud_follows_the_place_and_the_amount_of_the_release():
    made = model(estimate=["release_x", "release_y", "amount"], wind_speed_sd=0.0, wind_direction_sd=0.0)
    members = np.array(guess(made, 2).members)
    state = made.space.unpack(members)
    nodes = made.space["concentration"].coordinates
    state["release_x"][:, 0], state["release_y"][:, 0], state["amount"][:, 0] = nodes[7][0], nodes[7][1], [1.0, 2.5]
    settled = made.space.unpack(made.settled(members))
    assert settled["concentration"][:, 7].tolist() == [1.0, 2.5]
    assert settled["concentration"].argmax(axis=1).tolist() == [7, 7]
    np.testing.assert_allclose(settled["concentration"][1], 2.5 * settled["concentration"][0])


def test_a_certain_model_has_the_values_that_its_options_give():
    made = model(estimate=["diffusion", "amount"], certain=True, priors={"amount": {"name": "point", "mean": 3.0}})
    state = made.space.unpack(guess(made).members)
    assert (state["diffusion"] == made.transport.diffusion).all() and (state["amount"] == 1.0).all()
    assert (state["wind_speed"] == made.wind_speed).all()


def test_a_prior_replaces_the_usual_one():
    made = model(priors={"wind_speed": {"name": "uniform", "low": 2.0, "high": 3.0}})
    speed = made.space.unpack(guess(made, 30).members)["wind_speed"]
    assert speed.min() >= 2.0 and speed.max() <= 3.0


@pytest.mark.parametrize(
    "prior", [{"name": "uniform", "low": -1.0, "high": 1.0}, {"name": "normal", "mean": 0.0, "sd": 0.5}]
)
def test_a_direction_on_either_side_of_east_is_as_likely_after_a_turn(prior):
    made = model(priors={"wind_direction": prior})
    drawn = guess(made, 200)
    direction = drawn.members[:, made.space.slice("wind_direction")]
    assert direction.min() >= 0.0 and 50 < (direction > np.pi).sum() < 150
    turned = np.array(drawn.members)
    turned[:, made.space.slice("wind_direction")] -= 2.0 * np.pi
    density = made.log_first_guess(drawn.members)
    assert np.isfinite(density).all()
    np.testing.assert_allclose(made.log_first_guess(turned), density)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"estimate": ["weather"]}, "estimate: 'weather' cannot be estimated .accepted: diffusion, release_x"),
        ({"estimate": ["diffusion", "diffusion"]}, "estimate: a name stands twice"),
        ({"estimate": ["diffusion"], "transport": {"scheme": "supg"}}, "'supg' is made for one diffusion"),
        ({"priors": {"amount": {"name": "point", "mean": 1.0}}}, "priors: 'amount' is not estimated"),
        ({"priors": {"wind_speed": {"name": "gauss"}}}, "priors: wind_speed: there is no prior 'gauss'"),
        (
            {"estimate": ["amount"], "priors": {"amount": {"name": "normal", "mean": 1.0, "sd": 1.0}}},
            "model 'AdvectionDiffusion': priors: amount: prior 'normal' with mean 1, sd 1 is not one of a positive",
        ),
        (
            {"priors": {"wind_speed": {"name": "uniform", "low": -1.0, "high": 3.0}}},
            "priors: wind_speed: prior 'uniform' .* is not one of a nonnegative number: it goes down to -1",
        ),
    ],
)
def test_what_cannot_be_estimated_is_refused(options, message):
    with pytest.raises((ConfigurationError, OptionError), match=message):
        model(**options)
