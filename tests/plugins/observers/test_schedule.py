"""Readings at a fixed interval: none is lost or taken twice, for steps of any length."""

import itertools
import math

import pytest

import dafw
from dafw import ConfigurationError
from dafw.plugins.observers.schedule import is_due, require_steps

STEPS = [1e-9, 1e-5, 1.0 / 3.0, 0.05, 0.1, 0.7, 1.0, 60.0, 86400.0, math.pi * 1e7]


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("number", [1, 2, 3, 7, 1000])
def test_readings_are_due_exactly_once_in_every_so_many_steps(dt, number):
    for every in (number * dt, float(f"{number * dt:.12g}"), sum(itertools.repeat(dt, number))):
        require_steps(every, dt, "a test")
        due = [step for step in range(3 * number + 1) if is_due(step * dt, every, dt)]
        assert due == [0, number, 2 * number, 3 * number]


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("number", [1, 3, 10])
def test_times_may_be_long_sums_of_rounded_steps(dt, number):
    times = itertools.accumulate(itertools.repeat(dt, 100_000), initial=0.0)
    due = [step for step, t in enumerate(times) if is_due(t, number * dt, dt)]
    assert due == list(range(0, 100_001, number))


@pytest.mark.parametrize("dt", STEPS)
@pytest.mark.parametrize("number", [0.5, 1.5, 2.001, 100.1, 1e6 + 0.3])
def test_what_is_no_multiple_of_the_step_is_refused(dt, number):
    with pytest.raises(ConfigurationError, match="no multiple of the time step"):
        require_steps(number * dt, dt, "a test")


def test_without_a_step_the_time_itself_must_be_a_multiple():
    assert [t for t in (0.0, 0.5, 1.0, 1.999, 2.0, 4.0) if is_due(t, 2.0, 0.0)] == [0.0, 2.0, 4.0]
    assert is_due(0.1, None, 0.0)


def test_a_study_of_tiny_steps_reads_every_third(tmp_path):
    words = ["experiment=lorenz96", "cycles=9", "pictures=false", "model.dt=1e-5", "observer.every=3e-5"]
    with dafw.run(words, tmp_path / "run") as run:
        assert run["observation_value"].notnull().any("observation").values.tolist() == [
            False,
            *[True, False, False] * 3,
        ]
