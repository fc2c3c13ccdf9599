"""Ways around obstacles: exact where the shortest way runs along the grid's links, and never through a wall."""

import numpy as np
import pytest

from dafw import Domain
from dafw.core.ways import ways_in

WALL = np.array([[45.0, -1.0], [55.0, -1.0], [55.0, 75.0], [45.0, 75.0]])
ROOM = (0.0, 0.0, 100.0, 100.0)


def cost(ways, start, costs_at, per_metre=1.0):
    """The least cost from a place of the grid of reaching one of the places, which ask for what ``costs_at`` says."""
    costs = np.full(len(ways.points), np.inf)
    for place, price in costs_at.items():
        costs[ways.nearest(np.array(place))[0]] = price
    return ways.least(costs, per_metre)[ways.nearest(np.array(start))[0]]


def test_in_the_open_a_way_is_straight():
    ways = ways_in(Domain(ROOM), 10.0)
    assert len(ways.points) == 121
    for end in ([90.0, 10.0], [60.0, 60.0], [50.0, 30.0]):  # along links of all three lengths
        assert cost(ways, (10.0, 10.0), {tuple(end): 0.0}) == pytest.approx(np.hypot(end[0] - 10.0, end[1] - 10.0))
    rng = np.random.default_rng(1)
    for start, end in rng.integers(0, 11, (40, 2, 2)) * 10.0:
        straight = np.hypot(*(end - start))
        assert straight - 1e-9 <= cost(ways, start, {tuple(end): 0.0}) <= 1.028 * straight + 1e-9


def test_a_way_leads_around_a_wall_and_not_through_it():
    ways = ways_in(Domain(ROOM, (WALL,)), 10.0)
    # From (40, 0) up to (40, 80), across to (60, 80), and down again; the ends of the wall touch the ground.
    assert cost(ways, (40.0, 0.0), {(60.0, 0.0): 0.0}) == pytest.approx(180.0)


def test_it_goes_to_where_way_and_price_are_least_together():
    ways = ways_in(Domain(ROOM, (WALL,)), 10.0)
    prices = {(60.0, 0.0): -5.0, (0.0, 0.0): 30.0}
    assert cost(ways, (40.0, 0.0), prices, 0.1) == pytest.approx(0.1 * 180.0 - 5.0)
    assert cost(ways, (40.0, 0.0), prices, 1.0) == pytest.approx(40.0 + 30.0)


def test_where_no_way_leads_the_cost_is_infinite():
    across = np.array([[45.0, -1.0], [55.0, -1.0], [55.0, 101.0], [45.0, 101.0]])
    ways = ways_in(Domain(ROOM, (across,)), 10.0)
    assert cost(ways, (40.0, 0.0), {(60.0, 0.0): 0.0}) == np.inf
    assert cost(ways, (40.0, 0.0), {}) == np.inf
    assert cost(ways, (40.0, 0.0), {(0.0, 0.0): 0.0}) == pytest.approx(40.0)


def test_many_segments_at_once_are_judged_as_one_by_one():
    domain = Domain(ROOM, (WALL, np.array([[10.0, 50.0], [20.0, 50.0], [15.0, 60.0]])))
    rng = np.random.default_rng(2)
    starts, ends = rng.uniform(-10.0, 110.0, (2, 300, 2))
    ends[:100] = starts[:100] + rng.normal(0.0, 5.0, (100, 2))
    ends[:20] = starts[:20]  # vehicles that hover
    one_by_one = [domain.is_free(start, end) for start, end in zip(starts, ends, strict=True)]
    assert domain.are_free(starts, ends).tolist() == one_by_one
    assert any(one_by_one[:20]) and not all(one_by_one[:20])
    open_air = Domain(ROOM)
    assert open_air.are_free(starts, ends).tolist() == [
        open_air.is_free(*one) for one in zip(starts, ends, strict=True)
    ]


def test_the_ways_of_a_domain_are_made_once():
    domain = Domain((0.0, 0.0, 80.0, 40.0), (WALL / 4.0,))
    assert domain.ways is domain.ways
    steps = np.diff(np.unique(domain.ways.points[:, 0]))
    np.testing.assert_allclose(steps[steps > 0.0].min(), 1.0)
