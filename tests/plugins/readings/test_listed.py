"""A list of readings: the keys that each must have, and the entry of the state to which it belongs."""

from dataclasses import replace

import numpy as np
import pytest

from dafw import ANGLE, ConfigurationError, Domain, Model, Request, Selection, StateSpace, Study, Variable
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.readings.listed import Listed

CORNERS = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
FIELD = StateSpace([Variable("gas", 3, coordinates=CORNERS), Variable("rate", 1)])
GROUND = Domain((0.0, 0.0, 10.0, 10.0), triangles=np.array([[0, 1, 2]], dtype=np.int32))


def request(cycle=0, start=0.0, end=1.0):
    operator = Selection(indices=np.empty(0, dtype=np.int64), covariance=np.empty(0))
    return Request(cycle, start, end, FIELD, GROUND, operator)


def test_numbers_may_be_numpys():
    listed = Listed([{"time": np.float32(0.5), "value": np.int64(2), "entry": np.int64(1)}])
    (taken,) = listed.take(request(), None)
    assert taken.values.tolist() == [2.0] and taken.time == 0.5
    np.testing.assert_array_equal(taken.operator.apply(np.array([[5.0, 6.0, 7.0, 8.0]])), [[6.0]])


def test_a_variable_of_one_number_needs_no_entry():
    listed = Listed([{"time": 0.5, "value": 2.0}], variable="rate")
    listed.suit(FIELD, GROUND, 1.0)
    (taken,) = listed.take(request(), None)
    np.testing.assert_array_equal(taken.operator.apply(np.array([[5.0, 6.0, 7.0, 8.0]])), [[8.0]])


def test_a_reading_of_an_angle_is_refused_by_name():
    space = StateSpace([Variable("gas", 3, coordinates=CORNERS), Variable("direction", 1, ANGLE)])
    listed = Listed([{"time": 0.5, "value": 6.2}], variable="direction")
    with pytest.raises(ConfigurationError, match="readings 'Listed': 'direction' is an angle: expected readings of"):
        listed.collect(replace(request(), space=space), None, None)


def test_a_reading_between_the_nodes_is_interpolated():
    (taken,) = Listed([{"time": 0.5, "value": 2.0, "x": 5.0, "y": 0.0}]).take(request(), None)
    np.testing.assert_allclose(taken.operator.apply(np.array([[5.0, 6.0, 7.0, 8.0]])), [[5.5]])


def test_readings_are_given_when_they_become_known():
    times = [{"time": t, "value": 0.0, "entry": 0} for t in (-1.0, 0.0, 0.4, 1.0, 1.2)]
    listed = Listed([*times, {"time": 0.3, "value": 0.0, "entry": 0, "arrives": 1.5}])
    first, second = listed.take(request(), None), listed.take(request(1, 1.0, 2.0), None)
    assert [one.time for one in first] == [-1.0, 0.0, 0.4, 1.0]
    assert [one.time for one in second] == [1.2, 0.3]


class Still(Model):
    """One number that stays as it is."""

    space = StateSpace([Variable("level", 1)])

    def __init__(self, dt):
        self.dt = dt

    def initial(self, n_members, rng):
        return np.stack([rng[number].normal(5.0, 2.0, 1) for number in range(n_members)])

    def step(self, members, t, rng):
        return members.copy()


@pytest.mark.parametrize("dt", [0.05, 0.1, 0.3])
def test_a_reading_at_the_end_of_a_cycle_is_used_in_it_however_times_are_rounded(dt):
    listed = Listed([{"time": round((n + 1) * dt, 10), "value": float(n), "entry": 0, "sd": 1.0} for n in range(200)])
    assert listed.cycles_covered(dt) == 200
    study = Study(model=Still(dt), filter=ETKF(), readings=listed, members=3, cycles=200, seed=1)
    cycles = list(study)
    assert [cycle.observation.values.tolist() for cycle in cycles] == [[n] for n in range(200)]
    assert all(sum(one.readings.counts.values()) == one.readings.counts["on_time"] == 1 for one in cycles)


@pytest.mark.parametrize(
    ("reading", "message"),
    [
        ({"value": 1.0, "entry": 0}, "reading 0 must have a time, got value, entry"),
        ({"time": 1.0, "value": 1.0, "x": 1.0}, "must have x and y, or entry, got time, value, x"),
        ({"time": 1.0, "value": 1.0, "x": 1.0, "y": 1.0, "entry": 0}, "must have x and y, or entry"),
        ({"time": 1.0, "value": float("nan"), "entry": 0}, "value must be a finite number, got nan"),
        ({"time": True, "value": 1.0, "entry": 0}, "time must be a finite number, got True"),
        ({"time": 1.0, "value": "high", "entry": 0}, "value must be a finite number, got 'high'"),
        ({"time": 1.0, "value": 1.0, "entry": 0.5}, "entry must be a whole number, got 0.5"),
        ({"time": 1.0, "value": 1.0, "entry": 0, "sd": 0.0}, "sd must be above 0, got 0"),
        ({"time": 1.0, "value": 1.0, "entry": 0, "arrives": 0.5}, "arrives at 0.5 s, before its time, 1 s"),
        ({"time": 1.0, "value": 1.0, "entry": 0, "depth": 2.0}, "unknown 'depth'"),
    ],
)
def test_a_reading_that_is_not_whole_is_named(reading, message):
    with pytest.raises(ConfigurationError, match=message):
        Listed([reading])


@pytest.mark.parametrize(
    ("reading", "message"),
    [
        ({}, "reading 0 must have x and y, or entry: the variable 'gas' has 3 numbers"),
        ({"entry": 3}, "is about entry 3, the variable 'gas' has 3"),
        ({"x": 11.0, "y": 1.0}, r"reading 0 at \(11, 1\) m lies outside the domain"),
    ],
)
def test_a_reading_that_is_about_nothing_is_named(reading, message):
    with pytest.raises(ConfigurationError, match=message):
        Listed([{"time": 1.0, "value": 1.0, **reading}]).suit(FIELD, GROUND, 1.0)
