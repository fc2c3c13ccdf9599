"""The domain: where vehicles can fly."""

import numpy as np
import pytest
from shapely import LineString, Polygon, box

from dafw import Domain

SQUARE = np.array([[4.0, 4.0], [6.0, 4.0], [6.0, 6.0], [4.0, 6.0]])
DOMAIN = Domain((0.0, 0.0, 10.0, 10.0), (SQUARE,), ("hall",))


def test_what_is_in_the_way_is_named():
    """Of two obstacles it is the one that is met first; one without a name has its number."""
    two = Domain((0.0, 0.0, 20.0, 10.0), (SQUARE + np.array([10.0, 0.0]), SQUARE), ("far hall",))
    west, east, south = np.array([1.0, 5.0]), np.array([19.0, 5.0]), np.array([1.0, -1.0])
    assert (two.hindrance(west, east), two.hindrance(east, west)) == ("obstacle 1", "far hall")
    assert two.hindrance(west, south) == two.hindrance(south, west) == "the edge of the domain"
    assert two.hindrance(west, np.array([1.0, 9.0])) is None and two.hindrance(west, west) is None
    assert DOMAIN.hindrance(np.array([5.0, 5.0]), np.array([5.0, 5.0])) == "hall"


@pytest.mark.parametrize(
    ("start", "end", "free"),
    [
        ((1, 1), (9, 1), True),
        ((1, 5), (9, 5), False),
        ((1, 5), (4, 5), False),
        ((1, 5), (3.999, 5), True),
        ((5, 5), (5, 5), False),
        ((1, 1), (1, 1), True),
        ((1, 1), (-1, 1), False),
        ((0, 0), (10, 0), True),
    ],
)
def test_a_leg_is_free_when_it_stays_inside_and_touches_nothing(start, end, free):
    start, end = np.array(start, float), np.array(end, float)
    assert DOMAIN.is_free(start, end) is free
    assert DOMAIN.is_free(end, start) is free


def test_without_obstacles_only_the_rim_counts():
    assert Domain((0.0, 0.0, 1.0, 1.0)).is_free(np.array([0.1, 0.1]), np.array([0.9, 0.9]))


def test_it_agrees_with_shapely_about_legs_near_and_far():
    rng = np.random.default_rng(3)
    corners = rng.uniform(0.0, 100.0, (12, 2))
    rings = tuple(corner + rng.uniform(-9.0, 9.0, (3, 2)) for corner in corners)
    domain, ground = Domain((0.0, 0.0, 100.0, 100.0), rings), box(0.0, 0.0, 100.0, 100.0)
    polygons = [Polygon(ring) for ring in rings]
    answers = []
    for start in rng.uniform(0.0, 100.0, (200, 2)):
        end = start + rng.uniform(-12.0, 12.0, 2)
        leg = LineString([start, end])
        answers.append(domain.is_free(start, end))
        assert answers[-1] is (ground.covers(leg) and not any(leg.intersects(polygon) for polygon in polygons))
    assert any(answers) and not all(answers)


def test_a_distance_is_straight_where_no_obstacle_is_crossed():
    place, ends = np.array([4.0, 5.0]), np.array([[4.0, 5.0], [4.0, 4.2], [4.0, 1.0], [1.0, 9.0]])
    straight = np.linalg.norm(ends - place, axis=1)  # the place is on a wall, and so is the way to the second one
    np.testing.assert_array_equal(DOMAIN.distances(place, ends, 20.0), straight)
    np.testing.assert_array_equal(DOMAIN.distances(place, ends, 4.5), np.where(straight <= 4.5, straight, np.inf))


def test_a_distance_leads_around_an_obstacle():
    around = DOMAIN.distances(np.array([3.0, 5.0]), np.array([[7.0, 5.0], [3.0, 5.1]]), 20.0)
    shortest = 2.0 * np.sqrt(2.0) + 2.0
    assert shortest <= around[0] <= 1.1 * shortest
    np.testing.assert_allclose(around[1], 0.1)
    assert DOMAIN.distances(np.array([3.0, 5.0]), np.array([[7.0, 5.0]]), 4.5)[0] == np.inf


def test_no_way_leads_out_of_a_yard():
    rings = [[[2, 2], [8, 2], [8, 3], [2, 3]], [[2, 7], [8, 7], [8, 8], [2, 8]]]
    rings += [[[2, 2], [3, 2], [3, 8], [2, 8]], [[7, 2], [8, 2], [8, 8], [7, 8]]]
    yard = Domain((0.0, 0.0, 10.0, 10.0), tuple(np.array(ring, dtype=float) for ring in rings))
    np.testing.assert_array_equal(yard.distances(np.array([5.0, 5.0]), np.array([[1.0, 5.0]]), 100.0), [np.inf])


def test_a_place_on_the_edge_is_inside_though_it_is_rounded():
    ground = Domain((-400.0, -300.0, 400.0, 300.0))
    places = np.array([[-400.00000000000006, 0.0], [400.0, 300.0], [0.0, 300.0001], [0.0, 300.1], [-401.0, 0.0]])
    assert ground.are_inside(places).tolist() == [True, True, True, False, False]
