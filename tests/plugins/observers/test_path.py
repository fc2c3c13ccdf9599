"""The observer of means along lines."""

from __future__ import annotations

import numpy as np
import pytest

from dafw import ConfigurationError, Route, StateSpace, Variable
from dafw.plugins.models.dispersion.model import AdvectionDiffusion
from dafw.plugins.observers.path import Path

NODES = np.array([[x, y] for y in range(6) for x in range(6)], dtype=float) * 20.0
SPACE = StateSpace([Variable("speed", 2), Variable("concentration", 36, coordinates=NODES)])
LINES = {"short": [[10.0, 10.0], [30.0, 10.0]], "long": [[0.0, 0.0], [100.0, 70.0]]}


def test_several_paths_read_their_means_in_the_order_of_the_options():
    operator = Path(paths=LINES, noise_sd=0.1, assumed_variance=0.5).operator(SPACE, Route(), 0.0)
    field = 1.0 + NODES @ [0.5, -0.25]
    members = np.vstack([np.append([9.0, 9.0], field), np.append([0.0, 0.0], 2.0 * field)])
    read = operator.apply(members)
    np.testing.assert_allclose(read[0], [1.0 + 10.0 - 2.5, 1.0 + 25.0 - 8.75], rtol=1e-12)
    np.testing.assert_allclose(read[1], 2.0 * read[0], rtol=1e-12)
    assert operator.sensors == ("short", "long")
    np.testing.assert_allclose(operator.coordinates, [[20.0, 10.0], [50.0, 35.0]])
    assert operator.covariance.tolist() == [0.5, 0.5]
    np.testing.assert_allclose(operator.noise, 0.01)


def test_paths_are_read_when_they_are_due():
    observer = Path(paths=LINES, every=3.0)
    assert [observer.operator(SPACE, Route(), t).size for t in (0.0, 1.0, 2.0, 3.0)] == [2, 0, 0, 2]


def test_the_mesh_of_a_model_is_used():
    model = AdvectionDiffusion.from_options(**AdvectionDiffusion.check_options())
    variable = model.space["concentration"]
    np.testing.assert_array_equal(variable.triangles, model.domain.triangles)
    low_x, _, high_x, high_y = model.domain.bounds
    line = np.array([[low_x + 1.0, high_y - 1.0], [high_x - 1.0, high_y - 2.0]])
    operator = Path(paths={"edge": line.tolist()}).operator(model.space, Route(), 0.0)
    members = np.zeros((1, model.space.size))
    members[0, model.space.slice("concentration")] = variable.coordinates @ [0.5, 2.0]
    assert operator.apply(members)[0, 0] == pytest.approx(line.mean(axis=0) @ [0.5, 2.0], rel=1e-9)


def test_places_on_a_line_have_no_means_along_paths():
    space = StateSpace([Variable("concentration", 5, coordinates=np.arange(10.0).reshape(5, 2))])
    with pytest.raises(ConfigurationError, match="the 5 places of 'concentration' lie on a line"):
        Path(paths=LINES).suit(space, 1.0)


@pytest.mark.parametrize(
    ("paths", "said"),
    [
        ({}, "at least one path"),
        ({"a": [[0.0, 0.0]]}, r"path 'a' must be \[\[x, y\], \[x, y\]\]"),
        ({"a": "x"}, "path 'a' must be"),
        ({"a": [[0.0, 0.0], [float("nan"), 1.0]]}, "path 'a' must be"),
    ],
)
def test_wrong_paths_are_refused(paths, said):
    with pytest.raises(ConfigurationError, match=said):
        Path(paths=paths)


def test_a_path_that_leaves_the_mesh_is_refused_before_the_run():
    with pytest.raises(ConfigurationError, match=r"observer 'Path': the line from .* leaves the mesh"):
        Path(paths={"a": [[0.0, 0.0], [200.0, 0.0]]}).suit(SPACE, 1.0)
    with pytest.raises(ConfigurationError, match="no coordinates"):
        Path(paths=LINES, variable="speed").suit(SPACE, 1.0)
