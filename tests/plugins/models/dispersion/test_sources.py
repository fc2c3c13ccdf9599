"""Bursts and leaks: exact amounts of gas, superposition, several sources, what of them can be estimated."""

from __future__ import annotations

import numpy as np
import pytest

from dafw import FIELD, POSITIVE, ConfigurationError, OptionError
from dafw.core.rng import Streams
from dafw.plugins.models.dispersion.model import AdvectionDiffusion

LEAK = {"kind": "leak", "rate": 0.05}
SMALL_BELL = {"mesh": {"wall_size": 10.0, "far_size": 10.0}, "release": [50.0, 0.0], "release_radius": 6.0}
FINE = {"mesh": {"wall_size": 4.0, "far_size": 4.0}, "transport": {"diffusion": 2.0}, "release": [20.0, 0.0]}
"""With it Galerkin's ripples do not reach the rim either."""


@pytest.fixture(scope="module")
def make(small_site):
    """Return a maker of models ``ad`` in a light, certain wind, whose gas stays away from the rim."""

    def made(**options):
        wind = {"wind_speed": 1.0, "wind_direction": 2.0}
        return AdvectionDiffusion.from_options(**{"site": small_site, **SMALL_BELL, **wind, **options})

    return made


def guess(model, n_members=2):
    return np.array(model.first_guess(n_members, Streams(3).members("initial", 0)).ensemble.members)


def stepped(model, members, n_steps, t=0.0):
    """Return the members after some steps; the first begins at the time t."""
    for number in range(n_steps):
        members = model.step_with_memory(members, None, t + number * model.dt, None).members
    return members


def concentration(model, members):
    return model.space.unpack(members)["concentration"]


def gas(model, members):
    """Return the integral of the concentration (N,), in m^2."""
    mass = model._transport.matrices.before * model.dt
    return (mass @ concentration(model, members).T).sum(axis=0)


def test_a_leak_is_a_sum_of_bursts_one_for_each_step(make):
    burst, leak = make(), make(source=LEAK | {"start": 1.25})
    expected = 0.0
    for begin, seconds in ((1, 0.75), (2, 1.0), (3, 1.0), (4, 1.0)):
        expected = expected + 0.05 * seconds * concentration(burst, stepped(burst, guess(burst), 5 - begin, begin))
    found = concentration(leak, stepped(leak, guess(leak), 5))
    assert found.max() > 0.1
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize(
    ("start", "end", "seconds"),
    [(0.0, None, 4.0), (1.3, None, 2.7), (0.5, 2.25, 1.75), (3.4, 3.6, 0.2), (4.0, None, 0.0)],
)
def test_the_gas_is_rate_times_duration_to_the_fraction_of_a_step(make, start, end, seconds):
    burst, leak = make(**FINE), make(**FINE, source=LEAK | {"start": start, "end": end})
    unit = gas(burst, guess(burst))
    np.testing.assert_allclose(unit, 2.0 * np.pi * 6.0**2, rtol=1e-3)
    np.testing.assert_allclose(gas(leak, stepped(leak, guess(leak), 4)), 0.05 * seconds * unit, rtol=1e-10)


def test_the_flux_corrected_scheme_counts_every_bit_of_a_leaks_gas(make):
    corrected = {"transport": {"scheme": "fct", "outflow": "open"}, "wind_speed": 6.0, "wind_direction": 0.0}
    leak, burst = make(**corrected, source=LEAK | {"start": 1.25}, release=[85.0, 0.0]), make(release=[85.0, 0.0])
    members, gone = guess(leak), 0.0
    for second in range(5):
        step = leak.step_with_memory(members, None, float(second), None)
        members, gone = step.members, gone + step.diagnostics["gas_gone"].values
    assert (gone > 1.0).all() and members.min() >= 0.0
    np.testing.assert_allclose(gas(leak, members) + gone, 0.05 * 3.75 * gas(burst, guess(burst)), rtol=1e-10)


def test_every_member_has_its_own_rate_place_and_start(make):
    leak = make(source=LEAK, estimate=["release_x", "release_y", "rate", "leak_start"])
    members = guess(leak, 3)
    state = leak.space.unpack(members)
    for name, values in (("rate", [0.1, 0.2, 0.1]), ("leak_start", [0.0, 0.0, 2.5]), ("release_x", [50.0, 50.0, 40.0])):
        state[name][:, 0] = values
    state["release_y"][:] = 0.0
    after = stepped(leak, members, 4)
    one, twice, late = gas(leak, after)
    assert twice == pytest.approx(2.0 * one, rel=1e-9)
    alone = make(source={"kind": "leak", "rate": 0.1, "start": 2.5}, release=[40.0, 0.0])
    np.testing.assert_allclose(
        concentration(leak, after)[2], concentration(alone, stepped(alone, guess(alone), 4))[0], rtol=0.0, atol=1e-12
    )
    assert 0.3 < late / one < 0.45  # 1.5 of 4 s


def test_a_leak_that_began_before_the_study_leaks_from_its_start_on(make):
    leak = make(source=LEAK, estimate=["leak_start"])
    members = guess(leak, 2)
    leak.space.unpack(members)["leak_start"][:, 0] = [-7.0, 0.0]
    after = gas(leak, stepped(leak, members, 3))
    assert after[0] == after[1] > 0.0


def test_at_the_start_there_is_the_gas_of_bursts_alone(make):
    leak = make(source=LEAK, estimate=["rate"])
    assert (concentration(leak, guess(leak)) == 0.0).all()
    both = make(source=LEAK | {"more": [{"kind": "burst", "release": [-50.0, 0.0], "amount": 2.0}]})
    settled = concentration(both, both.settled(guess(both)))
    np.testing.assert_array_equal(settled, 2.0 * concentration(moved := make(release=[-50.0, 0.0]), guess(moved)))


def test_several_sources_add_up_and_each_has_its_own_names(make):
    first, second = {"release": [50.0, 0.0]}, {"release": [-50.0, 20.0], "release_radius": 9.0}
    amounts = {"amount": 2.0}, {"amount": 0.5}
    alone = [make(**place, source=amount) for place, amount in zip((first, second), amounts, strict=True)]
    more = [second | amounts[1], {"kind": "leak", "rate": 0.1, "release": [0.0, 50.0]}]
    together = make(source=amounts[0] | {"more": more})
    np.testing.assert_allclose(
        concentration(together, guess(together)), sum(concentration(one, guess(one)) for one in alone), rtol=1e-14
    )
    names = ["release_x", "release_y", "amount", "release_2_x", "release_2_y", "amount_2"]
    names += ["release_3_x", "release_3_y", "rate_3", "leak_start_3"]
    estimated = make(source=amounts[0] | {"more": more}, estimate=names, certain=True)
    assert [variable.name for variable in estimated.space.variables[3:]] == names
    state = estimated.space.unpack(guess(estimated, 1))
    values = [50.0, 0.0, 2.0, -50.0, 20.0, 0.5, 0.0, 50.0, 0.1, 0.0]
    assert [state[name].item() for name in names] == values
    np.testing.assert_array_equal(state["concentration"], concentration(together, guess(together, 1)))
    landmarks = {"release": (50.0, 0.0), "release_2": (-50.0, 20.0), "release_3": (0.0, 50.0)}
    assert estimated.domain.landmarks == landmarks


@pytest.mark.parametrize("source", [{}, LEAK], ids=["burst", "leak"])
def test_a_place_in_a_building_or_far_outside_may_be_proposed(make, source):
    model = make(source=source, estimate=["release_x", "release_y"])
    members = guess(model, 3)
    state = model.space.unpack(members)
    state["release_x"][:, 0], state["release_y"][:, 0] = [0.0, 1e5, 50.0], 0.0  # the tank, far away, where it is
    found = gas(model, stepped(model, model.settled(members), 2))
    assert np.isfinite(found).all() and found[1] == 0.0 < found[2]


def test_a_leaks_numbers_are_drawn_from_their_priors(make):
    model = make(source=LEAK | {"start": 40.0}, estimate=["leak_start", "rate"])
    assert (model.space["rate"].kind, model.space["rate"].units) == (POSITIVE, "s-1")
    assert (model.space["leak_start"].kind, model.space["leak_start"].units) == (FIELD, "s")
    state = model.space.unpack(guess(model, 60))
    assert np.median(state["rate"]) == pytest.approx(0.05, rel=0.5) and (state["rate"] > 0.0).all()
    assert 0.0 <= state["leak_start"].min() < 20.0 and 60.0 < state["leak_start"].max() <= 80.0
    assert np.isfinite(model.log_first_guess(guess(model, 5))).all()
    certain = make(source=LEAK | {"start": 40.0}, estimate=["leak_start", "rate"], certain=True)
    state = certain.space.unpack(guess(certain, 1))
    assert (state["rate"].item(), state["leak_start"].item()) == (0.05, 40.0)


def test_a_leak_in_still_air_is_plausible_for_an_hour(make):
    assert make(source=LEAK).space["concentration"].plausible >= 0.05 * 3600.0
    assert make().space["concentration"].plausible == make(source={"amount": 1.0}).space["concentration"].plausible


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"source": {"rate": 0.1}}, "source: 'rate' belongs to a leak, .*kind=leak, or rate=null"),
        ({"source": {"start": 5.0}}, "source: 'start' belongs to a leak"),
        ({"source": {"kind": "leak"}}, "source: a leak must be given its rate"),
        ({"source": LEAK | {"amount": 2.0}}, "source: 'amount' belongs to a burst"),
        ({"source": LEAK | {"start": 5.0, "end": 4.0}}, "must end after its start, got start=5 and end=4"),
        (
            {"source": {"more": [{"release": [1.0, 2.0], "rat": 3.0}]}},
            "source 2: unknown option 'rat', did you mean 'rate'",
        ),
        ({"source": {"more": [{"amount": 3.0}]}}, "source 2: option 'release' must be given"),
        ({"estimate": ["rate"]}, "'rate' cannot be estimated .*; it belongs to a leak: source.kind=leak"),
        ({"source": LEAK, "estimate": ["amount"]}, "accepted: .*, rate, leak_start.; it belongs to a burst"),
        ({"estimate": ["release_2_x"]}, "'release_2_x' cannot be estimated"),
    ],
)
def test_what_makes_no_sense_is_refused(make, options, message):
    with pytest.raises((ConfigurationError, OptionError), match=message):
        make(**options)


def test_further_sources_must_lie_in_the_open(make):
    with pytest.raises(ConfigurationError, match=r"release \[0.0, 0.0\] lies in a building"):
        _ = make(source={"more": [{"release": [0.0, 0.0]}]}).domain
