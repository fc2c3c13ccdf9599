"""The grid observer: which entries it reads, when, and with which error."""

import numpy as np
import pytest

from dafw.core.ensemble import Route
from dafw.core.errors import ConfigurationError
from dafw.core.space import StateSpace, Variable
from dafw.plugins.observers.grid import Grid

SPACE = StateSpace([Variable("u", 10, coordinates=np.arange(10.0)[:, np.newaxis]), Variable("v", 4)])


def look(observer, t=0.0):
    return observer.look(SPACE, Route(), t)


@pytest.mark.parametrize(
    ("options", "indices"),
    [
        ({}, range(10)),
        ({"stride": 3}, [0, 3, 6, 9]),
        ({"start": 1, "stride": 4}, [1, 5, 9]),
        ({"indices": [7, 2]}, [7, 2]),
        ({"variable": "v"}, [10, 11, 12, 13]),
        ({"variable": "v", "indices": [3]}, [13]),
    ],
)
def test_entries_are_counted_within_their_variable(options, indices):
    members = np.random.default_rng(0).normal(size=(3, 14))
    np.testing.assert_array_equal(look(Grid(**options)).apply(members), members[:, list(indices)])


def test_readings_are_due_every_so_often():
    observer = Grid(every=0.2)
    times = np.cumsum([0.0] + [0.05] * 12)  # times are sums of rounded steps
    due = [look(observer, float(t)).size for t in times]
    assert due == [10, 0, 0, 0] * 3 + [10]


def test_noise_and_what_the_filter_is_told_may_differ():
    operator = look(Grid(noise_sd=0.5, assumed_variance=4.0))
    np.testing.assert_array_equal(operator.noise, np.full(10, 0.25))
    np.testing.assert_array_equal(operator.covariance, np.full(10, 4.0))
    np.testing.assert_array_equal(look(Grid(noise_sd=0.5)).covariance, np.full(10, 0.25))


def test_readings_stand_where_the_variable_has_coordinates():
    np.testing.assert_array_equal(look(Grid(stride=5)).coordinates, [[0.0], [5.0]])
    assert look(Grid(variable="v")).coordinates is None


@pytest.mark.parametrize(
    ("options", "entry"), [({"indices": [3, 10]}, 10), ({"start": 10}, 10), ({"variable": "v", "start": 4}, 4)]
)
def test_an_entry_that_is_not_there_is_refused(options, entry):
    with pytest.raises(ConfigurationError, match=rf"observer 'Grid': .* there is no entry {entry}$"):
        look(Grid(**options))
