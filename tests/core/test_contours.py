"""Where a field on triangles is above a threshold: exact regions, contours, and polygons that a map program opens."""

import json

import geopandas
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.tri import Triangulation

from dafw.core.forecasts.contours import Regions, collection, contour_of, feature, in_degrees

SIDE = np.linspace(0.0, 10.0, 11)
NODES = np.stack(np.meshgrid(SIDE, SIDE), axis=-1).reshape(-1, 2)
TRIANGLES = Triangulation(*NODES.T).triangles.astype(np.int32)
X, Y = NODES.T
MESH = Regions(NODES, TRIANGLES)
ORIGIN = (8.0, 50.0)


def length(segments):
    return np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()


@settings(deadline=None)
@given(st.floats(-1.0, 11.0))
def test_the_region_of_a_linear_field_is_exact(limit):
    region = MESH.above(X, limit)
    assert region.area == pytest.approx(10.0 * np.clip(10.0 - limit, 0.0, 10.0), abs=1e-9)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(-1.0, 1.0))
def test_a_region_and_what_is_left_of_it_make_the_whole_mesh(seed, limit):
    field = np.random.default_rng(seed).standard_normal(len(NODES))
    above, below = MESH.above(field, limit), MESH.above(-field, -limit)
    assert above.is_valid and below.is_valid
    assert above.area + below.area == pytest.approx(100.0)
    assert above.intersection(below).area == pytest.approx(0.0, abs=1e-9)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_the_field_is_above_the_threshold_inside_and_below_it_outside(seed):
    rng = np.random.default_rng(seed)
    field = rng.standard_normal(len(NODES))
    region = MESH.above(field, 0.0)
    corners = TRIANGLES[rng.integers(len(TRIANGLES), size=50)]
    shares = rng.dirichlet([1.0, 1.0, 1.0], size=50)
    places, values = (shares[:, :, np.newaxis] * NODES[corners]).sum(axis=1), (shares * field[corners]).sum(axis=1)
    sure = np.abs(values) > 1e-9
    np.testing.assert_array_equal(shapely.contains_xy(region, *places.T)[sure], (values > 0.0)[sure])


def test_an_island_has_a_hole_where_the_field_sinks():
    ring = 9.0 - (np.hypot(X - 5.0, Y - 5.0) - 3.0) ** 2 * 9.0
    region = MESH.above(ring, 0.0)
    assert region.geom_type == "Polygon" and len(region.interiors) == 1


def test_a_field_that_equals_the_threshold_does_not_exceed_it():
    assert MESH.above(np.zeros(len(NODES)), 0.0).is_empty
    assert contour_of(NODES, TRIANGLES, np.zeros(len(NODES)), 0.0).shape == (0, 2, 2)


def test_a_contour_has_its_length_and_leaves_out_the_edge_of_the_mesh():
    straight = contour_of(NODES, TRIANGLES, X, 4.3)
    assert length(straight) == pytest.approx(10.0)
    np.testing.assert_allclose(straight[..., 0], 4.3)
    fine = np.linspace(0.0, 10.0, 101)
    nodes = np.stack(np.meshgrid(fine, fine), axis=-1).reshape(-1, 2)
    circle = contour_of(nodes, Triangulation(*nodes.T).triangles, -np.hypot(*(nodes - 5.0).T), -3.0)
    assert length(circle) == pytest.approx(6.0 * np.pi, rel=1e-3)


def test_polygons_in_degrees_open_in_another_program(tmp_path):
    field = np.sin(X) * np.cos(Y)
    region = MESH.above(field, 0.1)
    polygon = in_degrees(region, ORIGIN)
    assert polygon.is_valid and all(shapely.is_ccw(part.exterior) for part in polygon.geoms)
    file = tmp_path / "map.geojson"
    file.write_text(collection([feature(polygon, {"probability": 0.5, "arrival": float("inf"), "name": "a"})]))
    opened = geopandas.read_file(file)
    assert opened.crs.to_epsg() == 4326 and opened.is_valid.all()
    assert opened["arrival"].isna().all() and opened["probability"].tolist() == [0.5]
    # UTM's scale is 0.9996 to 1.001 there.
    assert opened.to_crs(opened.estimate_utm_crs()).area.sum() == pytest.approx(region.area, rel=3e-3)
    assert json.loads(file.read_text())["type"] == "FeatureCollection"
