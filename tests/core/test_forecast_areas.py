"""Areas on a mesh: where they are, and the largest value of a field in them."""

import json

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.tri import Triangulation

from dafw import ConfigurationError, Domain, ForecastPlan, Variable
from dafw.core.forecasts.areas import Area, Peaks, areas_of, buildings_of, places_of
from dafw.core.geography import to_degrees

SIDE = np.linspace(0.0, 10.0, 6)
NODES = np.stack(np.meshgrid(SIDE, SIDE), axis=-1).reshape(-1, 2)
TRIANGLES = Triangulation(*NODES.T).triangles.astype(np.int32)
GAS = Variable("gas", len(NODES), coordinates=NODES)
ORIGIN = (8.0, 50.0)
SITE = Domain((0.0, 0.0, 10.0, 10.0), triangles=TRIANGLES, origin=ORIGIN)
GATE = [[1.5, 1.5], [4.0, 1.0], [3.0, 4.5]]
IN_DEGREES = to_degrees(np.array(GATE), ORIGIN).tolist()


def peaks(*polygons, **more):
    areas = [Area(f"area {number}", polygon) for number, polygon in enumerate(polygons)]
    return Peaks(areas, GAS, SITE, **more)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_the_peak_is_the_largest_value_at_any_place_of_the_area(seed):
    rng = np.random.default_rng(seed)
    polygon = shapely.convex_hull(shapely.multipoints(rng.uniform(0.0, 10.0, (4, 2))))
    field = rng.standard_normal(len(NODES))
    (peak,) = peaks(polygon).of(field)
    # Of the parts of triangles in the polygon the corners decide; here they come from shapely's intersections.
    largest = -np.inf
    for corners in TRIANGLES:
        piece = shapely.Polygon(NODES[corners]).intersection(polygon)
        plane = np.linalg.solve(np.column_stack([NODES[corners], np.ones(3)]), field[corners])
        places = shapely.get_coordinates(piece)
        if len(places):
            largest = max(largest, (places @ plane[:2] + plane[2]).max())
    assert peak == pytest.approx(largest, abs=1e-9)


def test_many_fields_and_areas_at_once_are_each_alone():
    rng = np.random.default_rng(0)
    fields = rng.standard_normal((2, 3, len(NODES)))
    inner, outer = shapely.box(1.0, 1.0, 3.0, 2.0), shapely.box(0.5, 0.5, 9.0, 9.0)
    both = peaks(inner, outer).of(fields)
    assert both.shape == (2, 3, 2)
    np.testing.assert_array_equal(both[..., 0], peaks(inner).of(fields)[..., 0])
    np.testing.assert_array_equal(both[..., 1], peaks(outer).of(fields)[..., 0])
    assert (both[..., 1] >= both[..., 0]).all()


def test_an_area_within_one_triangle_is_interpolated():
    assert peaks(shapely.box(0.2, 0.2, 0.3, 0.5)).of(NODES[:, 1]) == pytest.approx([0.5])


def test_an_area_may_reach_beyond_the_site_but_not_lie_outside():
    assert peaks(shapely.box(-5.0, -5.0, 4.0, 3.0)).of(NODES[:, 0]) == pytest.approx([4.0])
    outside = shapely.box(20.0, 20.0, 30.0, 30.0)
    with pytest.raises(ConfigurationError, match="area 'area 0' holds no place of the model's domain"):
        peaks(outside)
    assert peaks(outside, skip=True).names == []


def test_without_areas_there_is_nothing_and_no_mesh_is_needed():
    line = Variable("level", 4, coordinates=np.arange(4.0)[:, np.newaxis])
    assert Peaks([], line, None).of(np.zeros((3, 4))).shape == (3, 0)
    with pytest.raises(ConfigurationError, match="areas need a model with a mesh of triangles"):
        Peaks([Area("gate", shapely.box(0, 0, 1, 1))], line, None)


def test_a_building_is_reached_at_its_walls():
    hole = np.array([[4.0, 4.0], [6.0, 4.0], [6.0, 6.0], [4.0, 6.0]])
    centre = NODES[TRIANGLES].mean(axis=1)
    outside = ~((centre > 4.0) & (centre < 6.0)).all(axis=1)
    domain = Domain((0.0, 0.0, 10.0, 10.0), (hole,), ("Stack",), TRIANGLES[outside])
    places = places_of(ForecastPlan(), GAS, domain)
    assert places.buildings.names == ["Stack"]
    assert places.buildings.of(NODES[:, 0]) == pytest.approx([6.01])
    assert [one.name for one in buildings_of(Domain((0.0, 0.0, 9.0, 9.0), (hole,)))] == ["building 0"]


def test_metres_degrees_and_a_file_name_the_same_area(tmp_path):
    ring = [*IN_DEGREES, IN_DEGREES[0]]
    shape = {"type": "Polygon", "coordinates": [ring]}
    feature = {"type": "Feature", "properties": {"name": "gate"}, "geometry": shape}
    (tmp_path / "areas.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    plans = [
        ForecastPlan(areas={"gate": GATE}),
        ForecastPlan(areas={"gate": IN_DEGREES}, area_units="degrees"),
        ForecastPlan(area_file=str(tmp_path / "areas.geojson")),
    ]
    for plan in plans:
        (area,) = areas_of(plan, SITE)
        assert area.name == "gate"
        assert area.polygon.symmetric_difference(shapely.Polygon(GATE)).area == pytest.approx(0.0, abs=1e-5)


def test_degrees_need_a_place_on_earth():
    nowhere = Domain((0.0, 0.0, 10.0, 10.0), triangles=TRIANGLES)
    with pytest.raises(ConfigurationError, match="area 'gate' is given in longitude and latitude"):
        areas_of(ForecastPlan(areas={"gate": IN_DEGREES}, area_units="degrees"), nowhere)


@pytest.mark.parametrize("corners", [[[0, 0], [2, 2], [2, 0], [0, 2]], [[0, 0], [1, 1], [2, 2]]])
def test_an_area_that_is_no_polygon_is_refused(corners):
    with pytest.raises(ConfigurationError, match="area 'gate' is no polygon"):
        areas_of(ForecastPlan(areas={"gate": corners}), SITE)


POINT = {"type": "Point", "coordinates": [8.0, 50.0]}
BROKEN = {
    "no JSON": "{",
    "another JSON": "[1, 2]",
    "no features": '{"type": "FeatureCollection", "features": []}',
    "a feature that is none": '{"features": [3]}',
    "no name": json.dumps({"features": [{"properties": {}, "geometry": POINT}]}),
    "no properties": json.dumps({"features": [{"properties": None, "geometry": POINT}]}),
    "a point": json.dumps({"features": [{"properties": {"name": "a"}, "geometry": POINT}]}),
    "no geometry": json.dumps({"features": [{"properties": {"name": "a"}, "geometry": None}]}),
    "no coordinates": json.dumps({"features": [{"properties": {"name": "a"}, "geometry": {"type": "Polygon"}}]}),
    "texts": '{"features": [{"properties": {"name": "a"}, "geometry": {"type": "Polygon", "coordinates": ["b"]}}]}',
    "crossing sides": json.dumps(
        {
            "features": [
                {
                    "properties": {"name": "a"},
                    "geometry": {"type": "Polygon", "coordinates": [[[8, 50], [9, 51], [9, 50], [8, 51], [8, 50]]]},
                }
            ]
        }
    ),
    "no numbers": '{"features": [{"properties": {"name": "a"}, "geometry": {"type": "Polygon", "coordinates": '
    "[[[8, 50], [NaN, 51], [9, 50], [8, 50]]]}}]}",
}


@pytest.mark.parametrize("text", BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_file_of_areas_is_one_clear_line(text, tmp_path):
    (tmp_path / "areas.geojson").write_text(text)
    with pytest.raises(ConfigurationError, match="study, forecast: ") as raised:
        areas_of(ForecastPlan(area_file=str(tmp_path / "areas.geojson")), SITE)
    assert "\n" not in str(raised.value)


def test_a_missing_file_and_two_areas_of_one_name_are_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="cannot be read as GeoJSON"):
        areas_of(ForecastPlan(area_file=str(tmp_path / "none.geojson")), SITE)
    test_metres_degrees_and_a_file_name_the_same_area(tmp_path)
    with pytest.raises(ConfigurationError, match="two areas are called 'gate'"):
        areas_of(ForecastPlan(areas={"gate": GATE}, area_file=str(tmp_path / "areas.geojson")), SITE)
