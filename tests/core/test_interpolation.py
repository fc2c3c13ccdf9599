"""Values between nodes, and a truth of another kind interpolated to the belief's state space."""

import numpy as np
import pytest
from toys import NODES, Growth, toy_parts

from dafw import ANGLE, NONNEGATIVE, ConfigurationError, Domain, Ensemble, StateSpace, Study, Variable, Vehicle
from dafw.core.cycle import advance, start
from dafw.core.interpolation import view, weights_at
from dafw.plugins.filters.none import NoFilter

TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
SQUARE = Domain((0.0, 0.0, 10.0, 10.0), triangles=TRIANGLES)
FINE = np.stack(np.meshgrid(np.linspace(0.0, 10.0, 5), np.linspace(0.0, 10.0, 5)), axis=-1).reshape(-1, 2)


def fine_triangles():
    from scipy.spatial import Delaunay

    triangles = Delaunay(FINE).simplices.astype(np.int32)
    a, b, c = (FINE[triangles[:, corner]] for corner in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    return np.where(area[:, np.newaxis] > 0, triangles, triangles[:, ::-1])


def plane(points):
    return 1.0 + 2.0 * points[:, 0] - 0.5 * points[:, 1]


@pytest.mark.parametrize("seed", range(3))
def test_a_linear_field_is_met_exactly_between_the_nodes(seed):
    points = np.random.default_rng(seed).uniform(0.0, 10.0, (50, 2))
    indices, weights = weights_at(Variable("gas", 4, coordinates=NODES), TRIANGLES, points)
    assert (weights >= -1e-12).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    np.testing.assert_allclose((plane(NODES)[indices] * weights).sum(axis=1), plane(points))


def test_a_node_is_itself_and_a_point_outside_the_nearest_node():
    variable = Variable("gas", 4, coordinates=NODES)
    for points, expected in ((NODES, plane(NODES)), (np.array([[11.0, -1.0]]), plane(NODES[[1]]))):
        indices, weights = weights_at(variable, TRIANGLES, points)
        np.testing.assert_allclose((plane(NODES)[indices] * weights).sum(axis=1), expected)


def test_on_a_line_values_are_linear_too_and_constant_beyond_its_ends():
    variable = Variable("u", 3, coordinates=np.array([[4.0], [0.0], [1.0]]))
    indices, weights = weights_at(variable, None, np.array([[0.5], [2.0], [-3.0], [9.0]]))
    values = np.array([40.0, 0.0, 10.0])
    np.testing.assert_allclose((values[indices] * weights).sum(axis=1), [5.0, 20.0, 0.0, 40.0])


def test_without_places_there_is_nothing_between():
    with pytest.raises(ConfigurationError, match="'rate' has no places in 2 dimensions"):
        weights_at(Variable("rate", 2), None, np.zeros((1, 2)))


# A truth of another kind


def space_on(nodes, *more):
    return StateSpace([Variable("gas", len(nodes), NONNEGATIVE, coordinates=nodes), *more])


def test_the_same_space_needs_no_view():
    space = space_on(NODES)
    assert view(space, SQUARE, space_on(NODES.copy()), "truth") is None


def test_a_state_on_a_finer_mesh_is_interpolated_and_single_numbers_meet_by_name():
    fine = space_on(FINE, Variable("direction", 1, ANGLE), Variable("speed", 1))
    coarse = space_on(NODES + 0.1 * (5.0 - NODES), Variable("speed", 1), Variable("direction", 1, ANGLE))
    seen = view(fine, Domain(SQUARE.bounds, triangles=fine_triangles()), coarse, "truth")
    state = fine.pack({"gas": plane(FINE), "direction": 3.0, "speed": 7.0})
    found = coarse.unpack(seen.of(Ensemble(state[np.newaxis], fine, 4.0)).members[0])
    np.testing.assert_allclose(found["gas"], plane(coarse["gas"].coordinates))
    assert (found["speed"], found["direction"]) == (7.0, 3.0)


def test_what_the_other_does_not_have_is_missing_but_for_the_first_variable():
    coarse = space_on(NODES, Variable("speed", 1))
    seen = view(space_on(FINE), Domain(SQUARE.bounds, triangles=fine_triangles()), coarse, "truth")
    assert np.isnan(seen.of(Ensemble(plane(FINE)[np.newaxis], space_on(FINE))).members[0, -1])
    with pytest.raises(ConfigurationError, match=r"the truth must have the variable 'gas' .nonnegative., it has none"):
        view(StateSpace([Variable("heat", 3)]), None, coarse, "truth")
    with pytest.raises(ConfigurationError, match="it has one of the kind field"):
        view(StateSpace([Variable("gas", 4, coordinates=NODES)]), None, coarse, "truth")


def test_numbers_without_places_are_not_guessed_at():
    with pytest.raises(ConfigurationError, match="truth's 'x' has 3 numbers, the model's 5: expected places"):
        view(StateSpace([Variable("x", 3)]), None, StateSpace([Variable("x", 5)]), "truth")


class Fine(Growth):
    """The toy model on more nodes: the gas is a linear function of the place and grows everywhere alike."""

    def initial(self, n_members, rng):
        return np.tile(self.space.pack({"gas": plane(FINE), "rate": self.rate}), (n_members, 1))

    def step(self, members, t, rng):
        stepped = members.copy()
        stepped[:, : len(FINE)] += members[:, len(FINE) :]
        return stepped


def fine_truth():
    truth = Fine(rate=2.0, space=StateSpace([Variable("gas", len(FINE), coordinates=FINE), Variable("rate", 1)]))
    truth.domain = Domain(SQUARE.bounds, triangles=fine_triangles())
    return truth


def test_readings_and_scores_are_of_the_truth_between_its_own_nodes():
    study = Study(
        model=Growth(), truth=fine_truth(), free=Growth(), filter=NoFilter(), observer=toy_parts().observer, speed=1.0,
        start=[[7.0, 6.0]], members=3, cycles=2,
    )  # fmt: skip
    parts, vehicle = study.prepare()
    state = start(parts, 3, vehicle)
    for number in (1, 2):
        cycle = advance(parts, state)
        state = cycle.state
        assert state.truth.ensemble.members.shape == (1, len(FINE) + 1)
        np.testing.assert_allclose(cycle.truth.members[0, :4], plane(NODES) + 2.0 * number)
        # the toy observer reads the belief's node that is nearest to the vehicle: (10, 10)
        assert abs(cycle.observation.values[0] - (plane(NODES[[2]])[0] + 2.0 * number)) < 0.6


def test_a_truth_with_another_time_step_and_a_free_run_of_another_space_are_refused():
    def study(**changes):
        return Study(**({"model": Growth(), "truth": Growth(), "filter": NoFilter(), "members": 2} | changes))

    with pytest.raises(ConfigurationError, match="the truth has dt = 1 s, the model 2 s"):
        study(truth=Growth(dt=1.0)).prepare()
    with pytest.raises(ConfigurationError, match=r"the free run has .* they must agree, in their coordinates too"):
        study(free=fine_truth()).prepare()
    assert study().prepare()[1].positions.shape == Vehicle(np.empty((0, 2))).positions.shape
