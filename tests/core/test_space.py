"""The state space: averages, differences and changes that respect the kinds of the variables."""

import numpy as np
import pytest

from dafw import ANGLE, FIELD, NONNEGATIVE, ConfigurationError, Ensemble, StateSpace, Variable

SPACE = StateSpace([Variable("height", 3, FIELD), Variable("gas", 2, NONNEGATIVE), Variable("direction", 1, ANGLE)])


def random_members(n_members: int, seed: int = 1) -> np.ndarray:
    generator = np.random.default_rng(seed)
    members = generator.standard_normal((n_members, SPACE.size))
    members[:, 3:5] = np.abs(members[:, 3:5])
    members[:, 5] = np.mod(members[:, 5], 2 * np.pi)
    return members


def test_retracting_the_difference_gives_the_other_point():
    a, b = random_members(2)
    np.testing.assert_allclose(SPACE.retract(b, SPACE.difference(a, b)), a, atol=1e-14)


@pytest.mark.parametrize("turn", [0.0, 0.3, np.pi, 6.0])
def test_the_circular_mean_turns_with_its_angles(turn):
    angles = np.array([6.1, 0.2, 0.4])
    space = StateSpace([Variable("direction", 1, ANGLE)])
    mean = space.mean(angles[:, None])
    turned = space.mean(np.mod(angles + turn, 2 * np.pi)[:, None])
    np.testing.assert_allclose(space.difference(turned, mean + turn), 0.0, atol=1e-14)


def test_the_mean_across_the_seam_is_at_the_seam():
    space = StateSpace([Variable("direction", 1, ANGLE)])
    mean = space.mean(np.array([[0.1], [2 * np.pi - 0.1]]))
    assert abs(space.difference(mean, np.zeros(1))[0]) < 1e-14


def test_differences_of_angles_lie_between_minus_pi_and_pi():
    angles = np.linspace(0.0, 2 * np.pi, 37, endpoint=False)[:, None]
    space = StateSpace([Variable("direction", 1, ANGLE)])
    differences = space.difference(angles[:, None], angles[None, :])
    assert differences.min() >= -np.pi and differences.max() < np.pi
    assert space.difference(np.array([np.pi]), np.zeros(1))[0] == -np.pi


def test_an_angle_a_hair_below_zero_becomes_zero_not_two_pi():
    space = StateSpace([Variable("direction", 1, ANGLE)])
    assert space.retract(np.zeros(1), np.array([-1e-18]))[0] == 0.0


def test_nonnegative_values_are_clamped_and_fields_are_not():
    moved = SPACE.retract(np.zeros(6), -np.ones(6))
    np.testing.assert_array_equal(moved[:5], [-1, -1, -1, 0, 0])


def test_every_variable_is_brought_into_its_own_set():
    space = StateSpace([Variable("gas", 2, NONNEGATIVE), Variable("turn", 2, ANGLE), Variable("rate", 1, NONNEGATIVE)])
    moved = space.retract(np.zeros((3, 5)), np.array([-1.0, 1.0, -1.0, 1.0, -1.0]))
    np.testing.assert_array_equal(moved, np.tile([0.0, 1.0, 2 * np.pi - 1.0, 1.0, 0.0], (3, 1)))


def test_spread_is_the_sample_standard_deviation():
    members = random_members(7)
    belief, alone = Ensemble(members, SPACE), Ensemble(members[:1], SPACE)
    np.testing.assert_allclose(belief.spread[:5], members[:, :5].std(axis=0, ddof=1))
    np.testing.assert_allclose(belief.variance[:5], members[:, :5].var(axis=0, ddof=1))
    assert np.isnan(alone.spread).all() and np.isnan(alone.variance).all()


def test_pack_and_unpack_are_inverse():
    members = random_members(4)
    np.testing.assert_array_equal(SPACE.pack(SPACE.unpack(members)), members)
    packed = SPACE.pack({"height": [1, 2, 3], "gas": [4, 5], "direction": 0.5})
    np.testing.assert_array_equal(packed, [1, 2, 3, 4, 5, 0.5])


def test_unpack_gives_views():
    members = random_members(2)
    SPACE.unpack(members)["gas"][:] = 9.0
    assert (members[:, 3:5] == 9.0).all()


def test_nothing_is_changed_in_place():
    members = random_members(3)
    members.setflags(write=False)
    mean = SPACE.mean(members)
    mean.setflags(write=False)
    SPACE.retract(mean, SPACE.difference(members, mean))


def test_nearest_finds_the_nearest_coordinates():
    variable = Variable("gas", 3, coordinates=np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]]))
    np.testing.assert_array_equal(variable.nearest(np.array([[8.0, 1.0], [1.0, 6.0]])), [1, 2])


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ([], "at least one variable"),
        ([Variable("a", 1), Variable("a", 2)], "two variables named 'a'"),
    ],
)
def test_spaces_that_make_no_sense_are_refused(variables, message):
    with pytest.raises(ConfigurationError, match=message):
        StateSpace(variables)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"name": "not a name", "size": 1}, "identifier"),
        ({"name": "a", "size": 0}, "at least 1"),
        ({"name": "a", "size": 2, "coordinates": np.zeros((3, 2))}, r"\(2, d\)"),
    ],
)
def test_variables_that_make_no_sense_are_refused(arguments, message):
    with pytest.raises(ConfigurationError, match=message):
        Variable(**arguments)


def test_spaces_agree_when_they_mean_the_same_at_the_same_places():
    places = np.zeros((2, 2))
    space = StateSpace([Variable("gas", 2, NONNEGATIVE, coordinates=places)])
    assert space.agrees(StateSpace([Variable("gas", 2, NONNEGATIVE, coordinates=places.copy())]))
    for other in (
        Variable("heat", 2, NONNEGATIVE, coordinates=places),
        Variable("gas", 2, FIELD, coordinates=places),
        Variable("gas", 2, NONNEGATIVE, coordinates=places + 1.0),
        Variable("gas", 2, NONNEGATIVE),
    ):
        assert not space.agrees(StateSpace([other]))


def test_an_unknown_variable_is_refused_with_the_names_there_are():
    with pytest.raises(ConfigurationError, match="height, gas, direction"):
        SPACE.slice("temperature")


def test_the_excess_is_how_far_members_are_beyond_what_is_plausible():
    space = StateSpace([Variable("gas", 3, plausible=2.0), Variable("rate", 1), Variable("speed", 1, plausible=10.0)])
    members = np.array([[1.0, -4.0, 0.0, 1e9, 5.0], [0.0, 0.0, 1.0, 0.0, 15.0]])
    assert space.excess(members) == 2.0 and space.excess(members[1:]) == 1.5
    assert space.excess(np.zeros((2, 5))) == 0.0
    assert space.farthest(members) == (0, 1) and space.place_of(1) == "'gas' at node 1"
    assert space.farthest(members[1:]) == (0, 4) and space.place_of(4) == "'speed'"
    members[1, 2] = np.nan
    assert np.isnan(space.excess(members))
    members[1, 2], members[0, 4] = np.inf, np.nan
    assert np.isnan(space.excess(members))


def test_where_nothing_is_said_to_be_plausible_the_largest_number_is_the_most_extreme():
    space = StateSpace([Variable("gas", 3), Variable("rate", 1)])
    members = np.array([[1.0, -4.0, 0.0, 2.0], [0.0, 0.0, 1.0, 3.0]])
    assert space.excess(members * 1e30) == 0.0
    assert space.farthest(members) == (0, 1)
    with pytest.raises(ConfigurationError, match="plausible must be above zero, got -1"):
        Variable("gas", 3, plausible=-1.0)
