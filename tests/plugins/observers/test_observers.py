"""Drone, stations, composite: which nodes are read, and which error variance the filter is given."""

import math
from itertools import pairwise

import numpy as np
import pytest

from dafw import ConfigurationError, OptionError, PluginError, Route, StateSpace, Variable
from dafw.plugins.observers.composite import Composite
from dafw.plugins.observers.drone import Drone, along
from dafw.plugins.observers.stations import Stations

GRID = np.array([[x, y] for y in range(11) for x in range(11)], dtype=float) * 10.0
SPACE = StateSpace([Variable("wind_speed", 1), Variable("concentration", 121, coordinates=GRID)])


def leg(*corners):
    return Route((np.array(corners, dtype=float),))


def read(observer, route, t=0.0):
    """Return the coordinates of the nodes read."""
    operator = observer.operator(SPACE, route, t)
    np.testing.assert_array_equal(GRID[operator.indices - 1], operator.coordinates)
    return operator.coordinates.tolist()


def test_a_drone_reads_one_or_two_nodes_on_a_leg():
    assert read(Drone(), leg((0, 0), (14, 0))) == [[10, 0]]
    assert read(Drone(), leg((0, 0), (20, 0))) == [[10, 0], [20, 0]]


def test_a_hovering_drone_reads_the_node_below_it():
    assert read(Drone(), leg((31, 42))) == [[30, 40]]


def test_samples_lie_at_equal_distances_along_a_bent_way():
    bent = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 5.0]])
    np.testing.assert_allclose(along(bent, 4), [[2, 0], [3, 1], [3, 3], [3, 5]])


def test_samples_have_the_bits_of_numpys_interpolation():
    rng = np.random.default_rng(5)
    for corners, n_samples in zip(rng.integers(2, 6, 300), rng.integers(1, 7, 300), strict=True):
        path = rng.uniform(-200.0, 200.0, (corners, 2))
        if rng.random() < 0.3:
            path[-1] = path[-2]  # the vehicle waits at the end
        travelled = np.append(0.0, np.cumsum([math.dist(*leg) for leg in pairwise(path)]))
        stations = np.arange(1, n_samples + 1) / n_samples * travelled[-1]
        expected = np.column_stack([np.interp(stations, travelled, path[:, axis]) for axis in (0, 1)])
        np.testing.assert_array_equal(along(path, n_samples), expected if travelled[-1] else path[:1])


def test_every_vehicle_is_read_and_no_vehicle_reads_nothing():
    both = Route((np.array([[0.0, 0.0]]), np.array([[50.0, 50.0]])))
    assert read(Drone(), both) == [[0, 0], [50, 50]]
    assert Drone().operator(SPACE, Route(), 0.0).size == 0


@pytest.mark.parametrize("make", [Drone, lambda **k: Stations(positions=[[0.0, 0.0]], **k)])
def test_the_filter_is_told_the_noise_unless_another_variance_is_assumed(make):
    route = leg((0, 0))
    plain = make(noise_sd=1e-3).operator(SPACE, route, 0.0)
    assert plain.covariance == pytest.approx(1e-6) and plain.noise == pytest.approx(1e-6)
    assumed = make(noise_sd=1e-3, assumed_variance=1e-3).operator(SPACE, route, 0.0)
    assert assumed.covariance == pytest.approx(1e-3) and assumed.noise == pytest.approx(1e-6)


def test_stations_read_the_nearest_node_when_they_are_due():
    stations = Stations(positions=[[31.0, 42.0], [1.0, 1.0]], every=3.0)
    sizes = [stations.operator(SPACE, Route(), t).size for t in np.arange(0.0, 7.0)]
    assert sizes == [2, 0, 0, 2, 0, 0, 2]
    assert read(stations, Route()) == [[30, 40], [0, 0]]


def test_stations_that_share_a_node_read_it_once():
    assert read(Stations(positions=[[1.0, 1.0], [2.0, 2.0]]), Route()) == [[0, 0]]


def test_a_composite_reads_its_parts_one_below_the_other():
    parts = {
        "drone": {"name": "drone", "assumed_variance": 1e-3},
        "poles": {"name": "stations", "positions": [[100.0, 100.0]], "noise_sd": 0.1},
    }
    operator = Composite(parts=parts).operator(SPACE, leg((0, 0), (20, 0)), 0.0)
    assert operator.coordinates.tolist() == [[10, 0], [20, 0], [100, 100]]
    np.testing.assert_allclose(operator.covariance, [1e-3, 1e-3, 1e-2])
    np.testing.assert_allclose(operator.noise, [1e-6, 1e-6, 1e-2])


@pytest.mark.parametrize(
    ("parts", "error", "message"),
    [
        ({}, ConfigurationError, "at least one observer"),
        ({"a": 3}, ConfigurationError, "part 'a' must be a mapping"),
        ({"a": {"name": "dron"}}, PluginError, "did you mean 'drone'"),
        ({"a": {"name": "drone", "sampels": 2}}, OptionError, "observer 'drone': unknown option 'sampels'"),
    ],
)
def test_a_composite_of_wrong_parts_is_refused(parts, error, message):
    with pytest.raises(error, match=message):
        Composite(parts=parts)


def test_a_variable_without_places_cannot_be_flown_over():
    with pytest.raises(ConfigurationError, match="'wind_speed' has no coordinates"):
        Drone(variable="wind_speed").operator(SPACE, leg((0, 0)), 0.0)
