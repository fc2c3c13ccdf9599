"""Sites: exact geometry for footprints drawn in metres, invariants for random ones, a one-line error for bad files."""

import json
from pathlib import Path

import numpy as np
import pytest
import shapely

from dafw.core.errors import SiteError
from dafw.core.geography import metres_per_degree
from dafw.core.options import build
from dafw.plugins.models.dispersion.site.options import SiteOptions
from dafw.plugins.models.dispersion.site.site import REPORT, load_site

WEST_OAKLAND = Path(__file__).resolve().parents[6] / "shared" / "data" / "west_oakland_buildings.geojson"
ORIGIN = np.array([8.0, 50.0])
SCALE = np.array(metres_per_degree(50.0))


def degrees(metres):
    return (np.asarray(metres, dtype=float) / SCALE + ORIGIN).tolist()


def rectangle(x_min, y_min, x_max, y_max):
    return [[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max], [x_min, y_min]]


def polygon(*rings):
    return {"type": "Polygon", "coordinates": [degrees(ring) for ring in rings]}


def feature(geometry, **properties):
    return {"type": "Feature", "properties": {"building": "yes", **properties}, "geometry": geometry}


# two distant corners, so that the centre of every site is the origin
POSTS = [feature(polygon(rectangle(*post))) for post in ((-200, -200, -190, -190), (190, 190, 200, 200))]


@pytest.fixture
def site_of(tmp_path):
    """Return a function that writes features to a file and loads the site; two posts fix its origin."""

    def make(*features, posts=True, **options):
        path = tmp_path / "site.geojson"
        collection = {"type": "FeatureCollection", "features": [*features, *(POSTS if posts else [])]}
        path.write_text(json.dumps(collection))
        return load_site(SiteOptions(file=str(path), **options))

    return make


def drawn(site):
    """Return the buildings that are not posts."""
    return [b for b in site.buildings if max(abs(b.centroid.x), abs(b.centroid.y)) < 190]


def assert_well_posed(site, narrowest_gap=4.0, rim=20.0):
    x_min, y_min, x_max, y_max = site.bounds
    room = shapely.box(x_min + rim, y_min + rim, x_max - rim, y_max - rim).buffer(0.01)
    for building in site.buildings:
        assert building.geom_type == "Polygon" and building.is_valid and not building.interiors
        assert room.covers(building)
    assert site.domain.is_valid and site.domain.geom_type == "Polygon"
    assert site.domain.area == pytest.approx(
        (x_max - x_min) * (y_max - y_min) - sum(building.area for building in site.buildings)
    )
    for i, first in enumerate(site.buildings):
        for second in site.buildings[:i]:
            # removing short sides moves a wall by less than their length, an eighth of the gap
            assert first.distance(second) > 0.75 * narrowest_gap
    assert len(site.names) == len(site.types) == len(site.buildings) == site.report["buildings"]


# --- geometry -------------------------------------------------------------------------------------------------------


def test_metres_agree_with_a_transverse_mercator_projection():
    from pyproj import Transformer

    site = load_site(SiteOptions())
    lon, lat = site.origin
    local = Transformer.from_crs(
        "EPSG:4326", f"+proj=tmerc +lon_0={lon} +lat_0={lat} +k=1 +ellps=WGS84", always_xy=True
    )
    corners = np.array([[-400.0, -300.0], [400.0, -300.0], [400.0, 300.0], [-400.0, 300.0], [250.0, 60.0]])
    projected = np.stack(local.transform(*site.to_degrees(corners).T), axis=1)
    # 2e-4: the meridians' convergence over half the height of the site
    np.testing.assert_allclose(projected, corners, rtol=0, atol=2e-4 * 400)
    np.testing.assert_allclose(site.to_metres(site.to_degrees(corners)), corners, rtol=0, atol=1e-6)


def test_a_concave_building_keeps_its_walls(site_of):
    shape = [[0, 0], [60, 0], [60, 40], [40, 40], [40, 15], [20, 15], [20, 40], [0, 40], [0, 0]]
    site = site_of(feature(polygon(shape), name="Hall", building="industrial"))
    (building,) = drawn(site)
    assert len(building.exterior.coords) == len(shape)
    assert building.hausdorff_distance(shapely.Polygon(shape)) < 2e-3
    assert "Hall" in site.names and "industrial" in site.types
    np.testing.assert_allclose(site.bounds, (-280, -280, 280, 280), atol=0.01)


def test_a_hole_is_filled(site_of):
    site = site_of(feature(polygon(rectangle(0, 0, 50, 50), rectangle(10, 10, 40, 40))))
    assert drawn(site)[0].area == pytest.approx(2500, rel=1e-3)
    assert site.report["holes_filled"] == 1


def test_a_bow_tie_is_repaired_and_a_flat_ring_is_dropped(site_of):
    bow_tie = [[0, 0], [40, 40], [40, 0], [0, 40], [0, 0]]
    site = site_of(feature(polygon(bow_tie)), feature(polygon([[0, -50], [30, -50], [60, -50], [0, -50]])))
    # the two halves touch at a point: joined there, they are one building of slightly more than 800 m^2
    assert sum(b.area for b in drawn(site)) == pytest.approx(800, rel=0.06)
    assert site.report["repaired"] == 1 and site.report["degenerate"] == 1
    assert_well_posed(site)


def test_rings_with_too_few_corners_and_empty_ones_are_dropped(site_of):
    site = site_of(feature(polygon([[0, 0], [10, 0]])), feature({"type": "Polygon", "coordinates": [[]]}))
    assert drawn(site) == [] and site.report["degenerate"] == 2


@pytest.mark.parametrize("other", [(40, 0, 80, 40), (30, 10, 80, 50), (42.5, 0, 80, 40), (41, 41, 80, 80)])
def test_touching_overlapping_and_near_buildings_become_one(site_of, other):
    site = site_of(
        feature(polygon(rectangle(0, 0, 40, 40)), name="A", building="industrial"),
        feature(polygon(rectangle(*other)), name="B", building="office"),
    )
    (merged,) = drawn(site)
    parts = shapely.union(shapely.box(0, 0, 40, 40), shapely.box(*other))
    assert merged.buffer(0.01).covers(parts)
    assert merged.area - parts.area < 4.0 * 40 + 1
    assert "A + B" in site.names and "industrial + office" in site.types
    assert site.report["merged"] == 1
    assert_well_posed(site)


def test_a_gap_between_parallel_walls_is_filled_exactly(site_of):
    site = site_of(feature(polygon(rectangle(0, 0, 40, 40))), feature(polygon(rectangle(43, 0, 80, 40))))
    assert drawn(site)[0].symmetric_difference(shapely.box(0, 0, 80, 40)).area < 0.5
    assert site.report["gaps_closed"] == 1


def test_a_passage_wider_than_the_narrowest_gap_stays_open(site_of):
    halves = [feature(polygon(rectangle(0, 0, 40, 40))), feature(polygon(rectangle(46, 0, 80, 40)))]
    assert len(drawn(site_of(*halves))) == 2
    assert len(drawn(site_of(*halves, narrowest_gap=7.0))) == 1


def test_a_chain_of_near_buildings_becomes_one(site_of):
    chain = [feature(polygon(rectangle(22 * k, 0, 22 * k + 20, 20)), name=f"Row {k}") for k in range(5)]
    site = site_of(*chain)
    assert drawn(site)[0].symmetric_difference(shapely.box(0, 0, 108, 20)).area < 0.5
    assert site.report["merged"] == 4 and site.report["gaps_closed"] == 4


def test_a_yard_behind_a_narrow_mouth_is_filled(site_of):
    with_mouth = [[0, 0], [29, 0], [29, 10], [10, 10], [10, 50], [50, 50], [50, 10], [31, 10], [31, 0], [60, 0]]
    site = site_of(feature(polygon([*with_mouth, [60, 60], [0, 60], [0, 0]])))
    assert drawn(site)[0].area == pytest.approx(3600, rel=1e-3)


def test_a_yard_between_four_buildings_is_filled(site_of):
    walls = [(0, 0, 60, 10), (0, 50, 60, 60), (0, 12, 10, 48), (50, 12, 60, 48)]
    site = site_of(*(feature(polygon(rectangle(*wall))) for wall in walls))
    assert drawn(site)[0].area == pytest.approx(3600, rel=1e-3)
    assert_well_posed(site)


def test_slivers_little_ones_and_short_sides_go(site_of):
    jog = [[0, 0], [30, 0], [30, 0.3], [60, 0.3], [60, 40], [0, 40], [0, 0]]
    site = site_of(
        feature(polygon(rectangle(0, -60, 50, -59.6))),
        feature(polygon(rectangle(-60, 0, -58, 2))),
        feature(polygon(jog)),
    )
    (building,) = drawn(site)
    assert len(building.exterior.coords) < len(jog)
    assert building.hausdorff_distance(shapely.Polygon(jog)) <= 0.3 + 2e-3
    counts = {key: site.report[key] for key in ("slivers_removed", "little_removed", "corners_removed")}
    assert counts == {"slivers_removed": 1, "little_removed": 1, "corners_removed": 1}


def test_random_footprints_make_well_posed_sites(site_of):
    rng = np.random.default_rng(7)
    for _ in range(12):
        features = []
        for _ in range(25):
            centre, radius = rng.uniform(-150, 150, 2), rng.uniform(1, 40)
            angles = rng.uniform(0, 2 * np.pi, rng.integers(3, 9))
            ring = centre + radius * rng.uniform(0.2, 1, (len(angles), 1)) * np.c_[np.cos(angles), np.sin(angles)]
            features.append(feature(polygon([*ring, ring[0]])))
        site = site_of(*features)
        assert_well_posed(site)
        assert site.report["footprints"] > 20 and len(site.buildings) >= 2


# --- limits ---------------------------------------------------------------------------------------------------------


def bounds_in_metres(x_min, y_min, x_max, y_max):
    return [*degrees([x_min, y_min]), *degrees([x_max, y_max])]


def test_bounds_set_the_rectangle_and_its_centre(site_of):
    site = site_of(feature(polygon(rectangle(0, 0, 40, 40))), bounds=bounds_in_metres(-120, -80, 100, 120))
    np.testing.assert_allclose(site.bounds, (-110, -100, 110, 100), atol=0.05)
    np.testing.assert_allclose(site.buildings[0].bounds, (10, -20, 50, 20), atol=0.05)
    assert site.report["outside"] == 2 and site.report["clipped"] == 0


def test_a_building_across_the_limits_is_cut_back_to_the_rim(site_of):
    site = site_of(feature(polygon(rectangle(40, 0, 150, 30))), bounds=bounds_in_metres(-100, -100, 100, 100))
    np.testing.assert_allclose(site.buildings[0].bounds, (40, 0, 80, 30), atol=0.01)
    assert site.report["clipped"] == 1
    assert_well_posed(site)


def test_no_building_at_all_is_legal_where_bounds_are_given(site_of):
    site = site_of(posts=False, bounds=bounds_in_metres(-100, -50, 100, 50))
    assert site.buildings == () and site.domain.area == pytest.approx(200 * 100, rel=1e-4)
    assert site.report_lines()[-1] == "0 buildings kept"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"bounds": [8.0, 50.0, 8.1]}, "got 3 numbers"),
        ({"bounds": [8.1, 50.0, 8.0, 50.1]}, "lon_min < lon_max"),
        ({"bounds": [8.0, 50.1, 8.1, 50.0]}, "lat_min < lat_max"),
        ({"bounds": [8.0, float("nan"), 8.1, 50.0]}, "lat_min < lat_max"),
        ({"bounds": [431000.0, 5512000.0, 432000.0, 5513000.0]}, "bounds in degrees"),
        ({"bounds": [8.0, 50.0, 9.0, 50.1]}, "sides of at most 20000 m"),
        ({"bounds": bounds_in_metres(-20, -20, 20, 20)}, "sides of at least 48 m"),
        ({"bounds": [9.0, 51.0, 9.01, 51.01]}, "none of its 2 footprints lies within the limits"),
        ({"margin": 5.0}, "margin is 5 m, expected at least the rim of 20 m"),
        ({"rim": 3.0}, "rim at least as wide as the narrowest gap"),
    ],
)
def test_limits_that_make_no_sense(site_of, options, message):
    with pytest.raises(SiteError, match=message) as caught:
        site_of(**options)
    assert "\n" not in str(caught.value) and caught.value.exit_status == 2


def test_a_building_that_covers_everything(site_of):
    for ring in (rectangle(-500, -500, 500, 500), rectangle(-79, -79, 79, 79)):
        with pytest.raises(SiteError, match="no free room"):
            site_of(feature(polygon(ring)), bounds=bounds_in_metres(-100, -100, 100, 100))


# --- files ----------------------------------------------------------------------------------------------------------


def test_nested_collections_and_multipolygons_are_read_and_the_rest_is_passed_over(site_of):
    first, second = polygon(rectangle(0, 0, 20, 20)), polygon(rectangle(60, 0, 80, 20))
    point, line = {"type": "Point", "coordinates": [8, 50]}, {"type": "LineString", "coordinates": [[8, 50], [8, 51]]}
    nested = {
        "type": "GeometryCollection",
        "geometries": [point, {"type": "GeometryCollection", "geometries": [first]}],
    }
    several = {
        "type": "MultiPolygon",
        "coordinates": [second["coordinates"], polygon(rectangle(60, 60, 80, 80))["coordinates"]],
    }
    height = {"type": "Polygon", "coordinates": [[[*position, 12.5] for position in degrees(rectangle(0, 60, 20, 80))]]}
    site = site_of(
        feature(nested),
        feature(several),
        feature(height, building=None, man_made="silo"),
        feature(None),
        feature(point),
        feature(line),
        feature(first, building="no"),
        {"type": "Feature", "properties": None, "geometry": first},
        {"type": "Feature", "geometry": None},
        {"type": "Feature", "properties": {"landuse": "grass"}, "geometry": {"type": "Polygon", "coordinates": "odd"}},
    )
    assert len(drawn(site)) == 4 and "silo" in site.types
    assert site.report["without_polygon"] == 3 and site.report["not_buildings"] == 4


def test_where_no_feature_is_tagged_every_polygon_counts(tmp_path):
    path = tmp_path / "bare.geojson"
    shapes = [{"type": "Feature", "properties": {}, "geometry": polygon(rectangle(k, 0, k + 20, 20))} for k in (0, 60)]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": shapes}))
    site = load_site(SiteOptions(file=str(path)))
    assert len(site.buildings) == 2 and site.report["untagged"] == 2
    assert any("no feature of the file is tagged" in line for line in site.report_lines())
    path.write_text(json.dumps(shapes[0]["geometry"]))
    assert len(load_site(SiteOptions(file=str(path))).buildings) == 1


def collection(geometry=None, **members):
    features = [] if geometry is None else [feature(geometry)]
    return json.dumps({"type": "FeatureCollection", "features": features, **members})


def one_ring(*positions):
    return {"type": "Polygon", "coordinates": [list(positions)]}


BAD_FILES = {
    "empty": ("", "is empty"),
    "blank": (" \n", "is empty"),
    "truncated": (collection(polygon(rectangle(0, 0, 9, 9)))[:-40], "cut off"),
    "prose": ("forty-five buildings", "not JSON"),
    "deep": ("[" * 100_000, "nested too deeply"),
    "list": ("[1, 2]", "FeatureCollection, got list"),
    "topojson": ('{"type": "Topology"}', "got type 'Topology'"),
    "features": ('{"type": "FeatureCollection", "features": {}}', "expected a list 'features'"),
    "feature": ('{"type": "FeatureCollection", "features": [7]}', "feature 1: expected an object"),
    "none": (collection(), "no building in it"),
    "mercator": (collection(crs={"type": "name", "properties": {"name": "EPSG:3857"}}), "CRS84, got 'EPSG:3857'"),
    "crs": (collection(crs="WGS84"), "CRS84"),
    "geometry": (collection({"type": "Circle", "radius": 3}), "GeoJSON geometry, got 'Circle'"),
    "no coordinates": (collection({"type": "Polygon"}), "expected a list 'coordinates'"),
    "no polygon": (collection({"type": "MultiPolygon", "coordinates": [3]}), "polygon as a list of rings"),
    "no ring": (collection({"type": "Polygon", "coordinates": [3]}), "ring as a list of positions"),
    "text": (collection(one_ring(["8", "50"])), "expected a position"),
    "short": (collection(one_ring([8.0])), "expected a position"),
    "metres": (collection(one_ring([431e3, 5512e3], [431e3 + 9, 5512e3], [431e3, 5512e3 + 9])), "degrees, got"),
    "local metres": (collection(one_ring([0, 0], [60, 0], [60, 40], [0, 40])), "are the coordinates longitude"),
    "nan": (collection(one_ring([float("nan"), 50], [8, 50], [8, 51])), "finite coordinates"),
    "infinite": (collection(one_ring([float("inf"), 50], [8, 50], [8, 51])), "finite coordinates"),
}


@pytest.mark.parametrize(("text", "message"), BAD_FILES.values(), ids=BAD_FILES.keys())
def test_bad_files_are_refused_in_one_line_that_names_them(tmp_path, text, message):
    path = tmp_path / "bad.geojson"
    path.write_text(text)
    with pytest.raises(SiteError, match=message) as caught:
        load_site(SiteOptions(file=str(path)))
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)


def test_missing_files_folders_and_binary_files(tmp_path):
    binary = tmp_path / "site.shp"
    binary.write_bytes(bytes(range(256)))
    for path, message in ((tmp_path / "nowhere", "not found"), (tmp_path, "cannot be read"), (binary, "not text")):
        with pytest.raises(SiteError, match=message):
            load_site(SiteOptions(file=str(path)))


def test_the_options_build_from_a_configuration():
    options = build(SiteOptions, {"bounds": [8, 50, 8.01, 50.01], "margin": 90}, "model 'ad', site")
    assert options == SiteOptions(bounds=[8.0, 50.0, 8.01, 50.01], margin=90.0)


# --- the two sites --------------------------------------------------------------------------------------------------


def test_the_plant():
    site = load_site(SiteOptions())
    assert_well_posed(site)
    np.testing.assert_allclose(site.bounds, (-400, -300, 400, 300), atol=0.5)
    assert len(site.buildings) == 45 and len(set(site.names)) == 45
    assert {"storage_tank", "cooling_tower", "flare", "warehouse", "office"} <= set(site.types)
    touched = {key for key, count in site.report.items() if count}
    assert touched == {"features", "not_buildings", "footprints", "buildings"}
    concave = [b for b in site.buildings if b.convex_hull.area > 1.1 * b.area]
    distances = [a.distance(b) for i, a in enumerate(site.buildings) for b in site.buildings[:i]]
    assert len(concave) >= 5 and 8 <= min(distances) <= 14
    release, drone = shapely.Point(258, 72), shapely.Point(130, -78)
    assert site.domain.boundary.distance(release) > 80 and site.domain.contains(release)
    assert site.domain.boundary.distance(drone) > 30 and site.domain.contains(drone)
    assert release.distance(drone) == pytest.approx(200, rel=0.02)


@pytest.mark.skipif(not WEST_OAKLAND.exists(), reason=f"the foreign footprints are not there: {WEST_OAKLAND}")
def test_west_oakland():
    site = load_site(SiteOptions(file=str(WEST_OAKLAND)))
    assert_well_posed(site)
    assert site.report["features"] == site.report["footprints"] == 23
    assert len(site.buildings) == 17 and site.report["merged"] == 6
    built = sum(building.area for building in site.buildings)
    assert built == pytest.approx(0.2 * 400 * 515, rel=0.15)
    assert set(site.report) == set(REPORT)
