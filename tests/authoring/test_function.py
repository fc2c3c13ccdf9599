"""Models that are plain functions."""

from __future__ import annotations

import numpy as np
import pytest

from dafw import NONNEGATIVE, Ensemble, OptionError, PluginError, StateSpace, Variable, model_from_function
from dafw.core.options import build, describe
from dafw.core.rng import Streams
from dafw.testing import check_model

SPACE = StateSpace([Variable("level", 4, NONNEGATIVE)])


def drain(members, t, dt, *, rate: float = 0.5, times: int = 1):
    """Reduce the numbers in place."""
    members *= (1.0 - rate * dt) ** times
    return members


def made(step=drain, **more):
    return model_from_function(step, space=SPACE, initial=lambda generator: generator.random(4), **more)


def stepped(model):
    return model.forecast(Ensemble(np.ones((2, 4)), SPACE), None, Streams(0).members("step", 0))


def test_it_conforms():
    check_model(made())
    check_model(lambda: made()(noise_sd=0.3))


def test_its_keyword_parameters_are_options():
    listed = {option.name: (option.type, option.default) for option in describe(made(dt=0.25))}
    expected = {"dt": ("float", 0.25), "noise_sd": ("float", 0.0), "rate": ("float", 0.5), "times": ("int", 1)}
    assert listed == expected
    model = build(made(), {"rate": 0.25, "times": 2}, "model 'drain'")
    assert np.array_equal(stepped(model).ensemble.members, np.full((2, 4), 0.5625))
    with pytest.raises(OptionError, match=r"'times' must be of type int, got 1\.5"):
        build(made(), {"times": 1.5}, "model 'drain'")


def test_noise_is_added_and_stays_in_the_set():
    members = stepped(made()(rate=1.0, noise_sd=1.0)).ensemble.members
    draws = Streams(0).members("step", 0).standard_normal((2, 4))
    assert np.array_equal(members, np.maximum(draws, 0.0))


@pytest.mark.parametrize(
    ("step", "message"),
    [
        (lambda members: members, r"expected <lambda>\(members, t, dt, \*, options\), got <lambda>\(members\)"),
        (lambda members, t, dt, rate=1.0: members, "expected"),
        (lambda members, t, **rest: members, "expected"),
        (lambda members, t, dt, *, rate=1.0: members, "option 'rate' needs a type and a default"),
    ],
)
def test_another_form_is_refused(step, message):
    with pytest.raises(PluginError, match=message):
        made(step)


def test_an_option_cannot_take_a_name_that_is_taken():
    def step(members, t, dt, *, noise_sd: float = 1.0):
        return members

    with pytest.raises(PluginError, match="an option cannot be called 'noise_sd'"):
        made(step)


def test_the_class_is_of_the_functions_module():
    assert (made().__module__, made().__qualname__) == (__name__, "drain")
