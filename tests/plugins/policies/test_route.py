"""Listed routes: flown as long as they are, whatever is believed, and refused if they lead through a building."""

from itertools import pairwise

import numpy as np
import pytest

from dafw import ConfigurationError, Domain, Vehicle
from dafw.core.experiment import study_from
from dafw.plugins.policies.route import ListedRoute, flown

SQUARE = [[0.0, 0.0], [30.0, 0.0], [30.0, 30.0], [0.0, 30.0]]
WALL = np.array([[10.0, -5.0], [20.0, -5.0], [20.0, 5.0], [10.0, 5.0]])
FAR = WALL + np.array([100.0, 0.0])
YARD = Domain((-50.0, -50.0, 150.0, 50.0), (FAR, WALL), ("far shed", "near shed"))


def fly(policy, vehicle, cycles):
    """Return the paths of every cycle, one list for each vehicle."""
    memory, paths = policy.initial_memory(vehicle), [[] for _ in vehicle.positions]
    for _ in range(cycles):
        route = policy.route(None, vehicle, memory, np.random.default_rng(0))
        for kept, path in zip(paths, route.paths, strict=True):
            kept.append(path)
        memory, vehicle = route.memory, vehicle.moved(route.ends)
    return paths


def length(path):
    return sum(np.linalg.norm(b - a) for a, b in pairwise(path))


def place_on(points, travelled):
    """Return where one is on a closed polyline after so many metres, by interpolation on its length."""
    corners = np.array([*points, points[0]])
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    return [np.interp(travelled % at[-1], at, corners[:, axis]) for axis in range(2)]


@pytest.mark.parametrize("reach", [7.0, 30.0, 100.0, 300.0])
def test_around_and_around_a_vehicle_is_where_its_length_says(reach):
    """It starts on the first point; 300 m are two and a half times around in one cycle."""
    vehicle = Vehicle(np.array(SQUARE[:1]), reach)
    (paths,) = fly(ListedRoute(points=SQUARE), vehicle, 20)
    for cycle, path in enumerate(paths, start=1):
        assert length(path) == pytest.approx(reach)
        np.testing.assert_allclose(path[-1], place_on(SQUARE, cycle * reach), atol=1e-9)


def test_no_corner_is_cut():
    (paths,) = fly(ListedRoute(points=SQUARE), Vehicle(np.array([[0.0, -10.0]]), 25.0), 1)
    np.testing.assert_allclose(paths[0], [[0.0, -10.0], [0.0, 0.0], [15.0, 0.0]])


def test_without_repetition_it_hovers_at_the_last_point():
    vehicle = Vehicle(np.array([[0.0, 0.0]]), 40.0)
    (paths,) = fly(ListedRoute(points=SQUARE, repeat=False), vehicle, 4)
    np.testing.assert_allclose(paths[2], [[10.0, 30.0], [0.0, 30.0]])
    np.testing.assert_array_equal(paths[3], [[0.0, 30.0]])


@pytest.mark.parametrize("points", [[[5.0, 0.0]], [[5.0, 0.0], [5.0, 0.0]]])
def test_a_single_place_is_reached_and_held(points):
    (paths,) = fly(ListedRoute(points=points), Vehicle(np.zeros((1, 2)), 3.0), 4)
    assert [path[-1].tolist() for path in paths] == [[3.0, 0.0], [5.0, 0.0], [5.0, 0.0], [5.0, 0.0]]


def test_a_vehicle_that_does_not_move_stays():
    (paths,) = fly(ListedRoute(points=SQUARE), Vehicle(np.array([[1.0, 2.0]]), 0.0), 2)
    assert [path.tolist() for path in paths] == [[[1.0, 2.0]]] * 2


def test_the_next_point_is_counted_at_the_moment_it_is_reached():
    path, upcoming = flown(np.zeros(2), np.array(SQUARE), 1, True, 30.0)
    assert (path.tolist(), upcoming) == ([[0.0, 0.0], [30.0, 0.0]], 2)
    path, upcoming = flown(np.array([0.0, 10.0]), np.array(SQUARE), 0, False, 10.0)
    assert (path.tolist(), upcoming) == ([[0.0, 10.0], [0.0, 0.0]], 1)


def test_every_vehicle_may_have_its_own_list():
    vehicle = Vehicle(np.zeros((2, 2)), 10.0)
    same = fly(ListedRoute(points=SQUARE), vehicle, 7)
    assert [path.tolist() for path in same[0]] == [path.tolist() for path in same[1]]
    own = fly(ListedRoute(points=[SQUARE, SQUARE[::-1]]), vehicle, 7)
    assert [path.tolist() for path in own[0]] == [path.tolist() for path in same[0]]
    np.testing.assert_allclose(own[1][-1][-1], [30.0, 20.0])


@pytest.mark.parametrize(
    "points", [[], None, 3, [[]], [[1.0]], [1.0, 2.0], [[1.0, "east"]], [[1.0, np.inf]], [SQUARE, []], [[True, 1.0]]]
)
def test_what_is_no_list_of_places_is_refused(points):
    with pytest.raises(ConfigurationError, match=r"points must be \[\[x, y\], ...\]"):
        ListedRoute(points=points)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([[130.0, 0.0]], "from [0.0, 0.0] to [130.0, 0.0] meets near shed; give it points on the way around"),
        ([[0.0, 20.0], [15.0, 20.0], [15.0, 0.0]], "from [15.0, 20.0] to [15.0, 0.0] meets near shed"),
        ([[0.0, 20.0], [25.0, 20.0], [25.0, 0.0]], "from [25.0, 0.0] to [0.0, 20.0] meets near shed"),
        ([[0.0, 60.0]], "meets the edge of the domain"),
        ([SQUARE, SQUARE, SQUARE], "must be one list for all vehicles, or 1, one for each; got 3 lists"),
    ],
)
def test_a_route_that_cannot_be_flown_is_refused_by_name(points, message):
    vehicle = Vehicle(np.zeros((1, 2)), 10.0, 1.0, YARD)
    with pytest.raises(ConfigurationError) as refusal:
        ListedRoute(points=points).suit_vehicles(vehicle)
    assert message in str(refusal.value) and str(refusal.value).startswith("policy '")


def test_the_way_back_to_the_first_point_need_not_be_free_if_it_is_not_flown():
    points = [[0.0, 20.0], [25.0, 20.0], [25.0, 0.0]]
    ListedRoute(points=points, repeat=False).suit_vehicles(Vehicle(np.zeros((1, 2)), 10.0, 1.0, YARD))


def test_a_study_refuses_it_before_anything_is_run():
    space = {"model": {"name": "ad", "site": {"bounds": [7.995, 50.0005, 7.9975, 50.0022]}}}
    space["model"] |= {"mesh": {"wall_size": 30.0, "far_size": 60.0, "across": 1}, "release": [-6.0, -45.0]}
    parts = {"observer": {"name": "drone"}, "filter": {"name": "none"}, "vehicle": {"start": [[-6.0, -20.0]]}}
    free, blocked = [[-6.0, -60.0]], [[-6.0, -60.0], [-6.0, 300.0]]
    study_from({**space, **parts, "policy": {"name": "route", "points": free}}).prepare()
    with pytest.raises(ConfigurationError, match="meets the edge of the domain"):
        study_from({**space, **parts, "policy": {"name": "route", "points": blocked}}).prepare()


def test_a_vehicle_that_is_not_where_it_was_sent_hovers_where_its_way_is_blocked():
    policy, blown = ListedRoute(points=[[0.0, 0.0], [0.0, 30.0]]), Vehicle(np.array([[25.0, 0.0]]), 8.0, airspace=YARD)
    memory = policy.initial_memory(blown)
    route = policy.route(None, blown, memory, np.random.default_rng(0))
    assert route.ends.tolist() == [[25.0, 0.0]] and "its way to the route is blocked" in route.notes[0]
    free = policy.route(None, blown.moved(np.array([[25.0, 20.0]])), route.memory, np.random.default_rng(0))
    assert free.notes == () and free.ends.tolist() != [[25.0, 20.0]]
