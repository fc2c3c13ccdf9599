"""EnIE-2D compared with an independent evaluation of the paper's formulas, and its paths around obstacles."""

import numpy as np
import pytest

from dafw import NONNEGATIVE, ConfigurationError, Domain, Ensemble, StateSpace, Variable, Vehicle
from dafw.plugins.policies.enie2d import EnIE2D, sector_scores

GENERATOR = np.random.default_rng(7)
NODES = GENERATOR.uniform(-50.0, 50.0, (200, 2))
MEMBERS = np.abs(GENERATOR.standard_normal((6, 200)))
RNG = np.random.default_rng(0)


def paper_scores(members, nodes, position, n_sectors, theta):
    """Evaluate eq. (EnIE) as printed, sector by sector and node by node."""
    n_members = len(members)
    scores = []
    for q in range(1, n_sectors + 1):
        inside = []
        for j, (x, y) in enumerate(nodes):
            angle = np.arctan2(y - position[1], x - position[0]) % (2 * np.pi)
            if (q - 1) * 2 * np.pi / n_sectors <= angle < q * 2 * np.pi / n_sectors:
                inside.append(j)
        if not inside:
            scores.append(-np.inf)
            continue
        chosen = members[:, inside]
        mean = chosen.sum(axis=0) / n_members
        anomalies = chosen - mean
        trace = np.trace(anomalies @ anomalies.T / (n_members - 1))
        scores.append((np.sqrt(trace) + theta * mean.sum()) / len(inside))
    return np.array(scores)


def belief_of(members, nodes, time=0.0):
    return Ensemble(members, StateSpace([Variable("concentration", len(nodes), NONNEGATIVE, "1", nodes)]), time)


@pytest.mark.parametrize("theta", [0.0, 0.2, 0.3])
@pytest.mark.parametrize("n_sectors", [1, 3, 8, 16, 128, 129, 300])
def test_scores_agree_with_the_paper(theta, n_sectors):
    for position in ([0.0, 0.0], [20.0, -30.0], NODES[3]):
        position = np.array(position)
        scores = sector_scores(MEMBERS.var(axis=0, ddof=1), MEMBERS.mean(axis=0), NODES, position, n_sectors, theta)
        np.testing.assert_allclose(scores, paper_scores(MEMBERS, NODES, position, n_sectors, theta), rtol=1e-10)


def test_nodes_on_the_edge_of_a_sector_belong_to_the_next_one():
    nodes = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    scores = sector_scores(np.zeros(4), np.array([1.0, 2.0, 3.0, 4.0]), nodes, np.zeros(2), 4, 1.0)
    np.testing.assert_array_equal(scores, [1.0, 2.0, 3.0, 4.0])


def test_a_single_member_is_certain():
    nodes = 30.0 * np.array([[1.0, 1.0], [-1.0, 1.0]])
    route = EnIE2D(sectors=4, theta=0.5).decide(belief_of([[1.0, 2.0]], nodes), Vehicle(np.zeros((1, 2)), 10.0), RNG)
    np.testing.assert_array_equal(route.diagnostics["sector_score"].values, [[0.5, 1.0, -np.inf, -np.inf]])


def test_an_empty_sector_is_never_chosen():
    nodes = np.array([[2.0, 1.0]])
    policy = EnIE2D(sectors=8, theta=1.0)
    route = policy.decide(belief_of(np.zeros((2, 1)), nodes), Vehicle(np.zeros((1, 2)), 10.0), RNG)
    assert np.isneginf(route.diagnostics["sector_score"].values[0, 1:]).all()
    np.testing.assert_allclose(route.ends, [[10 * np.cos(np.pi / 8), 10 * np.sin(np.pi / 8)]])


@pytest.mark.parametrize("quarter", range(4))
def test_it_flies_a_full_step_along_the_middle_of_the_best_sector(quarter):
    nodes = 30.0 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    members = np.zeros((2, 4))
    members[:, quarter] = [0.0, 1.0]
    route = EnIE2D(sectors=4).decide(belief_of(members, nodes), Vehicle(np.zeros((1, 2)), 10.0, 1.0), RNG)
    angle = np.pi / 4 + quarter * np.pi / 2
    np.testing.assert_allclose(route.ends, [[10 * np.cos(angle), 10 * np.sin(angle)]], atol=1e-12)
    np.testing.assert_array_equal(route.paths[0][0], [0.0, 0.0])


def blocked_airspace(*angles):
    """A square of 100 m with a small obstacle 5 m from the centre at each of the angles."""
    rings = []
    for angle in angles:
        centre = 5.0 * np.array([np.cos(angle), np.sin(angle)])
        rings.append(centre + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))
    return Domain((-50.0, -50.0, 50.0, 50.0), tuple(rings))


def test_a_blocked_way_is_replaced_clockwise():
    nodes = 30.0 * np.array([[1.0, 1.0]])
    angles = np.pi / 8 + np.arange(8) * np.pi / 4
    belief = belief_of(np.array([[0.0], [1.0]]), nodes)
    # The best of eight sectors contains the node at 45 degrees: number 2, with its middle at angles[1].
    best = EnIE2D(sectors=8).decide(belief, Vehicle(np.zeros((1, 2)), 10.0), RNG)
    np.testing.assert_allclose(best.ends[0], 10 * np.array([np.cos(angles[1]), np.sin(angles[1])]))
    once = Vehicle(np.zeros((1, 2)), 10.0, airspace=blocked_airspace(angles[1]))
    np.testing.assert_allclose(
        EnIE2D(sectors=8).decide(belief, once, RNG).ends[0], 10 * np.array([np.cos(angles[0]), np.sin(angles[0])])
    )
    twice = Vehicle(np.zeros((1, 2)), 10.0, airspace=blocked_airspace(angles[1], angles[0]))
    np.testing.assert_allclose(
        EnIE2D(sectors=8).decide(belief, twice, RNG).ends[0], 10 * np.array([np.cos(angles[7]), np.sin(angles[7])])
    )


def test_it_does_not_leave_the_domain():
    vehicle = Vehicle(np.array([[49.0, 0.0]]), 10.0, airspace=blocked_airspace())
    belief = belief_of(np.array([[0.0], [1.0]]), np.array([[200.0, 1.0]]))
    assert EnIE2D(sectors=8).decide(belief, vehicle, RNG).ends[0, 0] <= 50.0


def test_enclosed_on_all_sides_it_hovers_and_says_so():
    angles = np.pi / 8 + np.arange(8) * np.pi / 4
    vehicle = Vehicle(np.zeros((1, 2)), 10.0, airspace=blocked_airspace(*angles))
    route = EnIE2D(sectors=8).decide(belief_of(MEMBERS, NODES), vehicle, RNG)
    np.testing.assert_array_equal(route.paths[0], [[0.0, 0.0]])
    assert "vehicle 0 hovers" in route.notes[0]


def test_theta_may_follow_a_schedule():
    policy = EnIE2D(theta=[[0.0, 0.0], [10.0, 1.0]])
    assert [policy.weight(t) for t in (-1.0, 0.0, 5.0, 10.0, 99.0)] == [0.0, 0.0, 0.5, 1.0, 1.0]


@pytest.mark.parametrize("theta", ["much", [], [[0.0, 1.0], [0.0, 2.0]], [[1.0]], [[0.0, float("nan")]]])
def test_a_theta_that_is_none_is_refused(theta):
    with pytest.raises(ConfigurationError, match="theta must be a number or"):
        EnIE2D(theta=theta)


def test_several_vehicles_decide_each_for_itself():
    positions = np.array([[0.0, 0.0], [20.0, 20.0]])
    route = EnIE2D().decide(belief_of(MEMBERS, NODES), Vehicle(positions, 10.0), RNG)
    for number, position in enumerate(positions):
        alone = EnIE2D().decide(belief_of(MEMBERS, NODES), Vehicle(position[None], 10.0), RNG)
        np.testing.assert_array_equal(route.paths[number], alone.paths[0])
