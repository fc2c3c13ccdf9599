"""Values of a field at places and along lines: exact for linear fields, missing in buildings and outside."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString
from square import NODES, TIMES, X, Y, square
from xarray import Dataset

from dafw import RunError

PLANE = 1.0 + 2.0 * X - 0.5 * Y
RUN = square({"gas_mean": PLANE * np.array([[1.0], [2.0], [3.0]]), "gas_spread": X})
coordinate = st.floats(-1.0, 11.0)


def plane(points):
    return 1.0 + 2.0 * points[:, 0] - 0.5 * points[:, 1]


@settings(deadline=None, max_examples=50)
@given(st.lists(st.tuples(coordinate, coordinate), min_size=1, max_size=20))
def test_a_linear_field_is_exact_and_missing_outside_and_in_the_building(points):
    points = np.array(points)
    found = RUN.dafw.at("gas", points)
    assert found.dims == ("time", "point") and found.shape == (len(TIMES), len(points))
    off = np.maximum(np.abs(points - 5.0) - 5.0, 0.0).max(axis=1)
    deep = 1.0 - np.abs(points - 5.0).max(axis=1)
    sure = (np.abs(off - 1e-3) > 1e-6) & (np.abs(deep - 1e-3) > 1e-6)
    missing = (off > 1e-3) | (deep > 1e-3)
    np.testing.assert_array_equal(np.isnan(found[0])[sure], missing[sure])
    inside = sure & (off == 0.0) & (deep <= 0.0)
    for row in range(len(TIMES)):
        np.testing.assert_allclose(found[row][inside], (row + 1) * plane(points[inside]), atol=1e-9)


def test_a_node_is_itself_also_on_walls_and_a_hair_beside_them():
    used = np.unique(RUN["mesh2d_face_nodes"])
    for shift in (0.0, 1e-4):
        found = RUN.dafw.at("gas", NODES[used] + shift)[0]
        np.testing.assert_allclose(found, PLANE[used], atol=5e-4)
    np.testing.assert_allclose(found["point_x"], NODES[used, 0] + shift)


def test_any_field_of_the_file_or_made_of_it_is_taken():
    run = RUN.assign(gas_members=(("time", "member", "node"), np.stack([RUN["gas_mean"]] * 4, axis=1)))
    assert run.dafw.at("gas_members", [[1.0, 2.0]]).shape == (3, 4, 1)
    np.testing.assert_allclose(run.dafw.at(2.0 * run["gas_mean"].isel(time=0), [1.0, 2.0]), [4.0])
    np.testing.assert_allclose(run.dafw.at(run.dafw.quantile("gas", 0.5), [[1.0, 2.0]])[:, 0], [2.0, 4.0, 6.0])


def test_values_along_a_line_with_a_corner_and_through_the_building():
    corners = np.array([[1.0, 5.0], [9.0, 5.0], [9.0, 9.0]])
    for line in (corners, LineString(corners)):
        found = RUN.dafw.along("gas", line, 0.5)
        assert found.dims == ("time", "distance")
        np.testing.assert_allclose(found["distance"], np.arange(0.0, 12.25, 0.5))
        np.testing.assert_allclose(found["distance_x"], np.minimum(1.0 + found["distance"], 9.0))
        through = (found["distance"] > 3.001) & (found["distance"] < 4.999)
        np.testing.assert_array_equal(np.isnan(found[0]), through)
    uneven = RUN.dafw.along("gas", corners, 5.0)
    assert uneven["distance"].values.tolist() == [0.0, 5.0, 10.0, 12.0]


def test_one_run_of_a_sweep_over_meshes_is_padded():
    padded = RUN.pad(node=(0, 5), face=(0, 3))
    assert padded["mesh2d_face_nodes"].isnull().any() and padded["node_x"].isnull().any()
    points = np.random.default_rng(1).uniform(-1.0, 11.0, (50, 2))
    np.testing.assert_array_equal(padded.dafw.at("gas", points), RUN.dafw.at("gas", points))
    for filled in (False, True):
        (one,), (other,) = (run.dafw.contours("gas", 20.0, filled=filled) for run in (padded, RUN))
        assert not one.geometry.is_empty and one == other
    with pytest.raises(RunError, match="choose one run of the sweep first"):
        padded.assign_coords(node_x=padded["node_x"].expand_dims(size=2)).dafw.at("gas", points)
    faces = padded["mesh2d_face_nodes"].expand_dims(size=2)
    with pytest.raises(RunError, match="another mesh in one run than in another"):
        padded.assign(mesh2d_face_nodes=faces).dafw.at("gas", points)


def test_a_field_on_a_line_is_linear_between_its_nodes():
    run = Dataset({"u_mean": ("node", [0.0, 2.0, 0.0])}, {"node_x": ("node", [0.0, 1.0, 3.0])})
    np.testing.assert_allclose(run.dafw.at("u", [[0.5], [2.0], [3.0], [3.1]]), [1.0, 1.0, 0.0, np.nan])


def test_what_cannot_be_done_is_named():
    run = RUN.assign(rate_mean=("time", np.ones(3)), rate_spread=("time", np.ones(3)))
    for field, points, error in (
        ("rate", [[1.0, 1.0]], "'rate_mean' is a single number at each time"),
        ("wind", [[1.0, 1.0]], r"no variable 'wind' in this run \(state variables: gas, rate\)"),
        ("gas", [[1.0, np.nan]], "points must be finite"),
        ("gas", [], "points must be finite"),
        ("gas", "here", "points must be finite numbers"),
        ("gas", [[1.0, 1.0, 1.0]], "nodes have 2 coordinates, the points have 3"),
    ):
        with pytest.raises(RunError, match=error):
            run.dafw.at(field, points)
    with pytest.raises(RunError, match="is not on a mesh of triangles"):
        run.drop_vars("mesh2d_face_nodes").dafw.at("gas", [[1.0, 1.0]])
    with pytest.raises(RunError, match="has no places: the run has no node_x"):
        run.drop_vars(["node_x", "node_y"]).dafw.at("gas", [[1.0, 1.0]])
    with pytest.raises(RunError, match="a step above zero"):
        run.dafw.along("gas", [[0.0, 0.0], [1.0, 0.0]], 0.0)
