"""LookAhead against an independent evaluation of its formula, and on clouds whose best way is known."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest

from dafw import ANGLE, FIELD, NONNEGATIVE, ConfigurationError, Domain, Ensemble, Model, StateSpace, Variable, Vehicle
from dafw.core.ensemble import Forecast
from dafw.core.executors.serial import Serial
from dafw.core.experiment import study_from
from dafw.core.rerun import Rerun
from dafw.core.rng import Streams
from dafw.core.window import Outlook
from dafw.plugins.models.dispersion.model import AdvectionDiffusion
from dafw.plugins.policies.look_ahead import LookAhead, free_paths

SIDE = np.arange(-100.0, 101.0, 5.0)
GRID = np.stack(np.meshgrid(SIDE, SIDE), axis=-1).reshape(-1, 2)
ORIGIN = np.zeros((1, 2))


def space_of(nodes, kind=NONNEGATIVE):
    return StateSpace([Variable("gas", len(nodes), kind, "1", nodes), Variable("velocity", 2)])


@dataclass
class Drifting(Model):
    """Every member's field moves with its own velocity: what is read at a node was upstream of it."""

    space: StateSpace
    dt: float = 1.0

    def step(self, members, t, rng):
        state = self.space.unpack(members)
        nodes = self.space["gas"].coordinates
        upstream = nodes - self.dt * state["velocity"][:, np.newaxis]
        moved = [gas[self.space["gas"].nearest(places)] for gas, places in zip(state["gas"], upstream, strict=True)]
        return self.space.pack({"gas": np.array(moved), "velocity": state["velocity"]})


def cloud(x, y, width=8.0):
    """A bell on the grid, of which nothing is left three widths away."""
    bell = np.exp(-((GRID - [x, y]) ** 2).sum(axis=1) / (2.0 * width**2))
    return bell * (bell > 0.01)


def belief_of(gas, velocity=(0.0, 0.0), weights=None, nodes=GRID, kind=NONNEGATIVE):
    space = space_of(nodes, kind)
    members = space.pack({"gas": np.array(gas), "velocity": np.broadcast_to(velocity, (len(gas), 2))})
    return Ensemble(members, space, 0.0, weights)


def fly(policy, belief, vehicle=None, model=None):
    vehicle = vehicle or Vehicle(ORIGIN, 10.0)
    model = model or Drifting(belief.space, vehicle.dt)
    outlook = Outlook(Forecast(belief), vehicle, None, 0, Rerun(model, Serial(), Streams(0)))
    return policy.route(belief, vehicle, None, np.random.default_rng(0), outlook)


def heading(route, number=0):
    """The angle in degrees, from 0 to 360, at which a vehicle leaves."""
    x, y = route.ends[number] - route.paths[number][0]
    return np.degrees(np.arctan2(y, x)) % 360.0


def scores_by_hand(policy, fields, weights, nodes, vehicle):
    """Evaluate the formula as printed, path by path and reading by reading; ``fields`` (K, N, M), no obstacles."""

    def variance(node, cycle):
        values = np.log(np.maximum(fields[cycle - 1][:, node], 0.0) + policy.floor)
        return (weights * (values - (weights * values).sum()) ** 2).sum()

    scores = []
    for angle in np.arange(policy.headings) * 2.0 * np.pi / policy.headings:
        along = vehicle.reach * np.array([np.cos(angle), np.sin(angle)])
        score = 0.0
        for cycle in range(1, len(fields) + 1):
            for sample in range(1, policy.samples + 1):
                place = vehicle.positions[0] + (cycle - 1 + sample / policy.samples) * along
                node = int(np.argmin(((nodes - place) ** 2).sum(axis=1)))
                score += policy.discount ** (cycle * vehicle.dt) * variance(node, cycle) / policy.samples
        end, duration = vehicle.positions[0] + len(fields) * along, len(fields) * vehicle.dt
        afterwards = [
            policy.discount ** (duration + np.hypot(*(place - end)) / vehicle.speed) * variance(node, len(fields))
            for node, place in enumerate(nodes)
        ]
        scores.append(score + max(afterwards))
    return np.array(scores)


@pytest.mark.parametrize(("horizon", "samples", "dt"), [(3.0, 2, 1.0), (2.0, 1, 0.5), (0.1, 3, 1.0)])
def test_scores_agree_with_the_formula(horizon, samples, dt):
    rng = np.random.default_rng(7)
    nodes = rng.uniform(-60.0, 60.0, (150, 2))
    weights = np.array([0.1, 0.2, 0.3, 0.4])
    belief = belief_of(rng.standard_normal((4, 150)), rng.uniform(-5.0, 5.0, (4, 2)), weights, nodes)
    policy = LookAhead(horizon=horizon, headings=7, discount=0.8, floor=0.1, samples=samples)
    vehicle = Vehicle(np.array([[3.0, -2.0]]), 8.0, dt)
    model, members, fields = Drifting(belief.space, dt), belief.members, []
    for _ in range(max(1, round(horizon / dt))):
        members = model.step(members, 0.0, None)
        fields.append(members[:, :150])
    route = fly(policy, belief, vehicle)
    expected = scores_by_hand(policy, fields, weights, nodes, vehicle)
    np.testing.assert_allclose(route.diagnostics["heading_score"].values, [expected], rtol=1e-10)
    angle = np.argmax(expected) * 2.0 * np.pi / 7
    np.testing.assert_allclose(route.ends[0], [3.0 + 8.0 * dt * np.cos(angle), -2.0 + 8.0 * dt * np.sin(angle)])


@pytest.mark.parametrize("angle", [0, 45, 135, 270])
def test_it_flies_to_where_two_members_differ_and_not_to_where_they_agree(angle):
    where = 50.0 * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    shared = cloud(*-where)
    route = fly(LookAhead(headings=8), belief_of([shared, shared + cloud(*where)]))
    assert heading(route) == pytest.approx(angle)


def test_it_leads_a_cloud_that_moves():
    # At 10 m/s northwards along x = 50 the cloud is due east of the vehicle after 5 s, when the vehicle gets there.
    belief = belief_of([cloud(50.0, -50.0), np.zeros(len(GRID))], (0.0, 10.0))
    assert heading(fly(LookAhead(headings=8, horizon=6.0), belief)) == pytest.approx(0.0, abs=1e-9)
    # A forecast of one second does not show that: it flies to where the cloud is then.
    assert heading(fly(LookAhead(headings=8, horizon=1.0), belief)) == pytest.approx(315.0)


def test_the_discount_weighs_a_small_difference_soon_against_a_large_one_later():
    gas = np.zeros((2, len(GRID)))
    gas[0] = 0.02 * cloud(15.0, 0.0) + cloud(-60.0, 0.0)
    belief = belief_of(gas)
    ways = [heading(fly(LookAhead(headings=2, horizon=8.0, discount=g), belief)) for g in (0.3, 0.99)]
    assert ways == pytest.approx([0.0, 180.0], abs=1e-9)


def walled(*rings):
    return Domain((-100.0, -100.0, 100.0, 100.0), tuple(np.array(ring) for ring in rings))


def square(x, y, half=2.0):
    return [[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]]


def test_it_gets_round_a_building_and_never_through_it():
    belief = belief_of([cloud(60.0, 0.0), np.zeros(len(GRID))])
    wall = [[20.0, -60.0], [30.0, -60.0], [30.0, 40.0], [20.0, 40.0]]
    yard = [[-10.0, 30.0], [20.0, 30.0], [20.0, 40.0], [-10.0, 40.0]]  # the way round begins backwards
    domain = walled(wall, yard)
    vehicle, flown = Vehicle(ORIGIN, 10.0, airspace=domain), [ORIGIN[0]]
    assert not domain.is_free(ORIGIN[0], np.array([60.0, 0.0]))
    for _ in range(20):
        route = fly(LookAhead(horizon=4.0), belief, vehicle)
        flown.append(route.ends[0])
        vehicle = vehicle.moved(route.ends)
    assert all(domain.is_free(a, b) for a, b in pairwise(flown))
    assert min(np.hypot(x - 60.0, y) for x, y in flown) < 10.0


def test_a_path_ends_where_its_way_is_blocked():
    vehicle = Vehicle(ORIGIN, 10.0, airspace=walled(square(35.0, 0.0), square(0.0, 5.0), square(-45.0, 0.0)))
    paths = free_paths(ORIGIN[0], vehicle, 4, 6)
    np.testing.assert_array_equal(paths.legs, [3, 0, 4, 6])
    np.testing.assert_allclose(paths.ends[[0, 2, 3]], [[30.0, 0.0], [-40.0, 0.0], [0.0, -60.0]], atol=1e-12)
    east = [paths.places(cycle, 2)[0, :, 0].tolist() for cycle in (1, 3, 4, 6)]
    np.testing.assert_allclose(east, [[5.0, 10.0], [25.0, 30.0], [30.0, 30.0], [30.0, 30.0]])


def test_it_does_not_leave_the_domain():
    vehicle = Vehicle(np.array([[95.0, 0.0]]), 10.0, airspace=walled())
    nodes = np.array([[150.0, 0.0], [0.0, 0.0]])
    route = fly(LookAhead(headings=8), belief_of([[0.0, 0.0], [1.0, 0.0]], nodes=nodes), vehicle)
    assert vehicle.airspace.contains(route.ends[0])


def test_in_a_narrow_place_it_flies_shorter_legs():
    # A ring of walls with a bend as its only way out: 10 m are free nowhere, 5 m towards the north-east.
    around = [square(8.0 * np.cos(a), 8.0 * np.sin(a), 3.0) for a in np.arange(8) * np.pi / 4]
    around[1] = square(8.5, 8.5)
    vehicle = Vehicle(ORIGIN, 10.0, airspace=walled(*around))
    route = fly(LookAhead(headings=8), belief_of([cloud(60.0, 0.0), np.zeros(len(GRID))]), vehicle)
    np.testing.assert_allclose(route.ends, [[5.0 * np.sqrt(0.5)] * 2])
    assert not route.notes


def test_enclosed_on_all_sides_it_hovers_and_says_so():
    around = [square(1.0 * np.cos(a), 1.0 * np.sin(a), 0.5) for a in np.arange(8) * np.pi / 4]
    vehicle = Vehicle(ORIGIN, 10.0, airspace=walled(*around))
    route = fly(LookAhead(headings=8), belief_of([cloud(60.0, 0.0), np.zeros(len(GRID))]), vehicle)
    np.testing.assert_array_equal(route.paths[0], ORIGIN)
    assert route.notes == ("vehicle 0 hovers at [0.0, 0.0]: every way is blocked",)


@pytest.mark.parametrize("n_members", [1, 3])
def test_members_that_agree_send_it_to_where_they_expect_something(n_members):
    route = fly(LookAhead(headings=8), belief_of([cloud(0.0, 60.0)] * n_members))
    assert heading(route) == pytest.approx(90.0)


def test_where_nothing_is_expected_it_hovers_and_says_so():
    route = fly(LookAhead(), belief_of(np.zeros((3, len(GRID)))))
    np.testing.assert_array_equal(route.paths[0], ORIGIN)
    assert route.notes == ("vehicle 0 hovers at [0.0, 0.0]: nothing is expected anywhere",)


def test_a_member_without_weight_is_ignored():
    gas = [cloud(60.0, 0.0), np.zeros(len(GRID)), cloud(-40.0, 0.0)]
    policy = LookAhead(headings=8)
    assert heading(fly(policy, belief_of(gas))) == pytest.approx(180.0)
    without = fly(policy, belief_of(gas[:2]))
    ignored = fly(policy, belief_of(gas, weights=[0.5, 0.5, 0.0]))
    np.testing.assert_array_equal(ignored.paths[0], without.paths[0])
    np.testing.assert_allclose(*(r.diagnostics["heading_score"].values for r in (ignored, without)), rtol=1e-12)


def test_small_differences_below_the_floor_count_little():
    gas = [cloud(75.0, 0.0) + 1e-3 * cloud(-30.0, 0.0), np.zeros(len(GRID))]
    for floor, expected in ((0.01, 0.0), (1e-5, 180.0)):
        policy = LookAhead(headings=8, horizon=4.0, discount=0.5, floor=floor)
        assert heading(fly(policy, belief_of(gas))) == pytest.approx(expected, abs=1e-9)


def test_undershoots_below_zero_are_read_as_zero():
    gas = np.array([cloud(50.0, 0.0), np.zeros(len(GRID))])
    below = gas - 0.3 * np.array([cloud(-40.0, 0.0), np.zeros(len(GRID))])
    policy = LookAhead(headings=8)
    np.testing.assert_array_equal(fly(policy, belief_of(below)).paths[0], fly(policy, belief_of(gas)).paths[0])


def test_a_variable_that_may_be_negative_is_compared_as_it_is():
    gas = [-3.0 * cloud(0.0, 50.0) + 2.0 * cloud(0.0, -50.0), np.zeros(len(GRID))]
    assert heading(fly(LookAhead(headings=8), belief_of(gas, kind=FIELD))) == pytest.approx(90.0)


def test_of_equal_headings_it_takes_the_first_whatever_the_order_of_the_members():
    gas = [0.3 * sum(cloud(*p) for p in ((40, 0), (0, 40), (-40, 0), (0, -40))), 0.7 * cloud(90.0, 90.0)]
    gas += [0.1 * one for one in gas]
    vehicle = Vehicle(np.zeros((1, 2)), 10.0)
    for order in ([0, 1, 2, 3], [3, 1, 0, 2], [2, 3, 1, 0]):
        route = fly(LookAhead(headings=4, horizon=5.0), belief_of([gas[i] for i in order]), vehicle)
        assert heading(route) == pytest.approx(0.0, abs=1e-9)


def test_several_vehicles_decide_each_for_itself():
    belief = belief_of([cloud(60.0, 0.0) + cloud(-50.0, 50.0), np.zeros(len(GRID))])
    positions = np.array([[0.0, 0.0], [-50.0, -50.0], [80.0, 80.0]])
    together = fly(LookAhead(), belief, Vehicle(positions, 10.0))
    for number, position in enumerate(positions):
        alone = fly(LookAhead(), belief, Vehicle(position[np.newaxis], 10.0))
        np.testing.assert_array_equal(together.paths[number], alone.paths[0])


def test_without_a_vehicle_nothing_is_forecast():
    class Never(Drifting):
        def step(self, members, t, rng):
            raise AssertionError("forecast for nobody")

    belief = belief_of([cloud(60.0, 0.0)])
    assert fly(LookAhead(), belief, Vehicle(np.empty((0, 2)), 10.0), Never(belief.space)).paths == ()


def test_what_has_no_places_in_the_plane_or_no_order_is_refused():
    line = StateSpace([Variable("u", 3, coordinates=np.arange(3.0)[:, np.newaxis])])
    with pytest.raises(ConfigurationError, match="'LookAhead': the variable 'u' has no coordinates in the plane"):
        LookAhead().suit(line)
    with pytest.raises(ConfigurationError, match="policy 'LookAhead': no state variable 'v'"):
        LookAhead(variable="v").suit(line)
    angles = StateSpace([Variable("towards", 2, ANGLE, coordinates=np.zeros((2, 2)))])
    with pytest.raises(ConfigurationError, match="policy 'LookAhead': the variable 'towards' holds angles"):
        LookAhead().suit(angles)


def test_without_a_name_it_compares_the_first_variable_with_places():
    space = StateSpace([Variable("speed", 1), Variable("gas", 1, coordinates=np.zeros((1, 2)))])
    LookAhead().suit(space)
    with pytest.raises(ConfigurationError, match="the variable 'speed' has no coordinates in the plane"):
        LookAhead(variable="speed").suit(space)


def test_it_flies_as_many_legs_as_asked_for_and_then_decides_again():
    policy, belief = LookAhead(legs=3), belief_of([cloud(60.0, 0.0), cloud(80.0, 0.0)])
    vehicle, memory, begun = Vehicle(ORIGIN, 10.0), None, []
    for cycle in range(7):
        outlook = Outlook(Forecast(belief), vehicle, memory, cycle, Rerun(Drifting(belief.space), Serial(), Streams(0)))
        route = policy.route(belief, vehicle, memory, np.random.default_rng(0), outlook)
        begun += [cycle] if route.diagnostics else []
        vehicle, memory = vehicle.moved(route.ends), route.memory
    assert begun == [0, 3, 6]
    np.testing.assert_allclose(vehicle.positions, [[70.0, 0.0]], atol=1e-9)


def test_it_decides_before_the_free_legs_of_a_path_are_over():
    wall = Domain(
        (-100.0, -100.0, 100.0, 100.0), obstacles=[np.array([[15.0, -80.0], [18.0, -80.0], [18.0, 80.0], [15.0, 80.0]])]
    )
    paths = free_paths(ORIGIN[0], Vehicle(ORIGIN, 10.0, airspace=wall), 24, 5)
    assert paths.legs[0] == 1
    route = fly(
        LookAhead(legs=3, headings=1),
        belief_of([cloud(60.0, 0.0), cloud(80.0, 0.0)]),
        Vehicle(ORIGIN, 10.0, airspace=wall),
    )
    np.testing.assert_array_equal(route.memory["left"], [0])


def test_it_decides_anew_where_a_vehicle_is_not_where_it_was_sent_and_the_way_is_blocked():
    belief, domain = belief_of([cloud(60.0, 0.0), cloud(80.0, 0.0)]), walled(square(36.0, 0.0))
    memory = {"steps": np.array([[10.0, 0.0]]), "left": np.array([2])}
    for place, decided in (([[0.0, 0.0]], False), ([[30.0, 0.0]], True)):
        vehicle = Vehicle(np.array(place), 10.0, airspace=domain)
        outlook = Outlook(Forecast(belief), vehicle, memory, 0, Rerun(Drifting(belief.space), Serial(), Streams(0)))
        route = LookAhead(horizon=4.0).route(belief, vehicle, memory, np.random.default_rng(0), outlook)
        assert bool(route.diagnostics) is decided
        assert domain.is_free(vehicle.positions[0], route.ends[0]) and (route.ends != vehicle.positions).any()


def flown(executor):
    """The routes of a small study in uncertain winds, with model error; its decisions as bytes."""
    parts = {"observer": "drone", "filter": "etkf", "executor": executor}
    study = study_from(
        {kind: {"name": name} for kind, name in parts.items()}
        | {
            "policy": {"name": "look_ahead", "legs": 1},
            "model": {"name": "ad", **AdvectionDiffusion.check_options()},
            "members": 4,
            "cycles": 3,
            "vehicle": {"start": [[-6.0, -20.0]]},
            "pictures": False,
        }
    )
    return [(c.route.ends, c.diagnostics["policy"]["heading_score"].values, c.belief.members) for c in study]


def test_the_same_bits_every_time_and_with_worker_processes():
    first = flown("serial")
    assert len({ends.tobytes() for ends, _, _ in first}) == 3  # it flies
    for executor in ("serial", "processes"):
        for one, other in zip(first, flown(executor), strict=True):
            assert all(a.tobytes() == b.tobytes() for a, b in zip(one, other, strict=True))


def test_with_the_coarser_version_it_decides_as_if_that_were_the_model():
    coarse_nodes = GRID[::3]

    class Fine(Drifting):
        def coarser(self):
            return Drifting(space_of(coarse_nodes), self.dt)

    clouds, velocity = [cloud(40.0, 30.0), cloud(45.0, -20.0)], [[-3.0, 1.0], [2.0, 2.0]]
    fine = belief_of(clouds, velocity)
    coarse = belief_of([one[::3] for one in clouds], velocity, nodes=coarse_nodes)
    scores = [
        fly(LookAhead(horizon=4.0, coarser=coarser), belief, model=model).diagnostics["heading_score"].values
        for coarser, belief, model in [(True, fine, Fine(fine.space)), (False, coarse, None), (False, fine, None)]
    ]
    np.testing.assert_array_equal(scores[0], scores[1])
    assert (scores[0] != scores[2]).any()


def test_a_study_whose_model_has_no_coarser_version_is_refused():
    with pytest.raises(ConfigurationError, match="has no coarser version"):
        fly(LookAhead(coarser=True), belief_of([cloud(50.0, 0.0), cloud(0.0, 50.0)]))
