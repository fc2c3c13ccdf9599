"""The twin reads the truth; slow sensors follow what they meet as the exact solution says, each on its own."""

import numpy as np
import pytest

from dafw import ConfigurationError, Ensemble, Route, Selection, StateSpace, Variable
from dafw.core.interfaces.readings import Request
from dafw.plugins.observers.composite import Composite
from dafw.plugins.observers.drone import Drone
from dafw.plugins.observers.grid import Grid
from dafw.plugins.observers.stations import Stations
from dafw.plugins.readings.twin import Twin

LINE = np.stack([10.0 * np.arange(21), np.zeros(21)], axis=1)
SPACE = StateSpace([Variable("concentration", 21, coordinates=LINE)])
QUIET = {"noise_sd": 1e-14}


def read(twin, observer, fields, paths=None, dt=1.0):
    """Return the readings of cycles in which the truth is one of ``fields`` (21,) at the end, and the last memory."""
    memory, found = twin.initial_memory(), []
    for cycle, field in enumerate(fields):
        route = Route(tuple(np.array(path, dtype=float) for path in paths[cycle]) if paths else ())
        operator = observer.look(SPACE, route, cycle * dt)
        truth = Ensemble(np.asarray(field, dtype=float)[np.newaxis], SPACE, (cycle + 1) * dt)
        request = Request(cycle, cycle * dt, (cycle + 1) * dt, SPACE, None, operator, truth)
        taken = twin.collect(request, memory, np.random.default_rng(cycle))
        memory = taken.memory
        found.append(taken.observations[0].values)
    return found, memory


class SilentGrid(Grid):
    """Reads one entry and does not say by which sensor."""

    def operator(self, space, route, t):
        return Selection(indices=np.array([3]), covariance=np.array([0.1]))


@pytest.mark.parametrize("dt", [1.0, 0.25])
def test_a_sensor_that_stands_still_approaches_the_concentration_exponentially(dt):
    found, _ = read(Twin(lag=5.0), Stations([[30.0, 0.0]], every=dt, **QUIET), [np.full(21, 2.0)] * 12, dt=dt)
    times = dt * np.arange(1, 13)
    np.testing.assert_allclose(np.concatenate(found), 2.0 * (1.0 - np.exp(-times / 5.0)), rtol=1e-9)


def test_a_moving_sensor_remembers_what_it_met_on_its_way():
    # Two nodes a step; the first cloud is left behind and still shown.
    paths = [[[[0, 0], [20, 0]]], [[[20, 0], [40, 0]]]]
    field = np.zeros(21)
    field[[1, 2]] = 1.0, 4.0
    found, _ = read(Twin(lag=2.0), Drone(**QUIET), [field, field], paths)
    stay = np.exp(-0.5 / 2.0)
    first = 1.0 - stay
    second = 4.0 + (first - 4.0) * stay
    np.testing.assert_allclose(np.concatenate(found), [first, second, second * stay, second * stay**2], rtol=1e-9)


def test_sensors_do_not_mix_and_one_that_read_nothing_for_a_while_is_as_far_as_its_time():
    parts = {"poles": {"name": "stations", "positions": [[0.0, 0.0], [200.0, 0.0]], "every": 3.0, **QUIET}}
    observer = Composite(parts={**parts, "drone": {"name": "drone", **QUIET}})
    paths = [[[[100, 0], [100, 0]], [[50, 0], [50, 0]]]] * 4
    field = np.zeros(21)
    field[[0, 20, 10, 5]] = 1.0, 2.0, 3.0, 0.0
    found, memory = read(Twin(lag=4.0), observer, [field] * 4, paths)
    risen = 1.0 - np.exp(-np.arange(1, 5) / 4.0)
    np.testing.assert_allclose([values[-2:] for values in found], np.outer(risen, [3.0, 0.0]), atol=1e-12)
    assert [len(values) for values in found] == [4, 2, 2, 4]
    np.testing.assert_allclose(found[3][:2], [risen[3], 2.0 * risen[3]], rtol=1e-9)
    assert set(memory) == {"0 station 0", "0 station 1", "1 drone 0", "1 drone 1"}


def test_without_a_lag_the_truth_is_read_and_nothing_remembered():
    found, memory = read(Twin(), Grid(**QUIET), [np.arange(21.0), np.ones(21)])
    np.testing.assert_allclose(found, [np.arange(21.0), np.ones(21)], atol=1e-12)
    assert memory is None


def test_a_small_lag_is_no_lag():
    fields = [np.arange(21.0), np.ones(21)]
    np.testing.assert_array_equal(*(read(Twin(lag=lag), Grid(), fields)[0] for lag in (0.0, 1e-3)))


def test_an_observer_that_does_not_tell_its_sensors_is_named():
    with pytest.raises(ConfigurationError, match="readings 'Twin': lag = 5 s needs to know which sensor"):
        read(Twin(lag=5.0), SilentGrid(), [np.ones(21)])
