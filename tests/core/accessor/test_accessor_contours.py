"""Contours of a run: circles of a cone, at the right times, and in longitude and latitude."""

import geopandas
import numpy as np
import pytest
import shapely
from square import EVERY, ORIGIN, TIMES, X, Y, square

from dafw import RunError
from dafw.core.geography import to_metres

CONE = 5.0 - np.hypot(X - 5.0, Y - 5.0)
RUN = square({"gas_mean": CONE * np.array([[0.0], [1.0], [2.0]]), "gas_spread": X}, triangles=EVERY, **ORIGIN)


def test_the_contour_of_a_cone_is_a_circle():
    line, area = (RUN.dafw.contours("gas", 2.0, 2.0, filled=filled) for filled in (False, True))
    assert (line[0].time, line[0].level) == (2.0, 2.0) and line[0].geometry.is_ring
    circle = shapely.Point(5.0, 5.0).buffer(3.0, 256)
    for ring in (shapely.Polygon(line[0].geometry), area[0].geometry):
        assert ring.is_valid and ring.area == pytest.approx(circle.area, rel=0.02)
        assert ring.hausdorff_distance(circle) < 0.1
    assert line[0].geometry.length == pytest.approx(6.0 * np.pi, rel=0.02)


def test_a_straight_contour_through_nodes_is_one_line_in_its_place():
    run = square({"gas_mean": X, "gas_spread": X}, triangles=EVERY)
    for level in (3.0, 3.3):
        (found,) = run.dafw.contours("gas", level)
        assert found.geometry.geom_type == "LineString"
        np.testing.assert_allclose(found.geometry.bounds, [level, 0.0, level, 10.0], atol=1e-12)
        assert found.geometry.length == pytest.approx(10.0)


def test_a_contour_ends_at_a_building():
    run = square({"gas_mean": Y, "gas_spread": X})
    (found,) = run.dafw.contours("gas", 5.2)
    assert sorted(part.length for part in found.geometry.geoms) == pytest.approx([4.0, 4.0])
    (found,) = run.dafw.contours("gas", 5.0, filled=True)
    assert found.geometry.area == pytest.approx(50.0 - 2.0)


def test_times_and_levels():
    found = RUN.dafw.contours("gas", [1.0, 9.0], [0.4, 2.6, 4.0])
    assert [(one.time, one.level) for one in found] == [(t, v) for t in TIMES for v in (1.0, 9.0)]
    assert [one.geometry.is_empty for one in found] == [True, True, False, True, False, False]
    assert RUN.dafw.contours("gas", 1.0)[0].time == 4.0
    (one,) = RUN.dafw.contours(2.0 * RUN["gas_mean"].isel(time=1), 4.0)
    assert one.time == 2.0 and one.geometry.length == pytest.approx(6.0 * np.pi, rel=0.02)


def test_geojson_is_the_same_in_degrees(tmp_path):
    for filled in (False, True):
        path = RUN.dafw.to_geojson(tmp_path / "map.geojson", "gas", [1.0, 2.0], [0.0, 2.0, 4.0], filled=filled)
        opened = geopandas.read_file(path)
        assert opened.crs.to_epsg() == 4326 and opened.is_valid.all()
        wanted = [
            one for one in RUN.dafw.contours("gas", [1.0, 2.0], TIMES, filled=filled) if not one.geometry.is_empty
        ]
        assert opened[["time", "level"]].values.tolist() == [[one.time, one.level] for one in wanted]
        assert set(opened["variable"]) == {"gas_mean"} and set(opened["units"]) == {"kg m-3"}
        for degrees, one in zip(opened.geometry, wanted, strict=True):
            back = shapely.transform(degrees, lambda places: to_metres(places, (8.0, 50.0)))
            assert back.hausdorff_distance(one.geometry) < 2e-3
            assert back.length == pytest.approx(one.geometry.length, rel=1e-3)
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_without_contours_opens_too(tmp_path):
    path = RUN.dafw.to_geojson(str(tmp_path / "none.geojson"), "gas", 99.0)
    assert len(geopandas.read_file(path)) == 0


def test_what_cannot_be_done_is_named(tmp_path):
    with pytest.raises(RunError, match="no time near 9 s: it is from 0 to 4 s"):
        RUN.dafw.contours("gas", 1.0, 9.0)
    with pytest.raises(RunError, match="levels must be a finite number"):
        RUN.dafw.contours("gas", np.nan)
    with pytest.raises(RunError, match="choose along member first"):
        RUN.dafw.contours(RUN["gas_mean"].expand_dims(member=2), 1.0)
    unrecorded = RUN.assign(gas_mean=RUN["gas_mean"].where(RUN["time"] != 2.0))
    with pytest.raises(RunError, match=r"was not recorded at 2 s: run the study with record\.fields=all"):
        unrecorded.dafw.contours("gas", 1.0, 2.0)
    nowhere = RUN.copy()
    nowhere.attrs = {"scored_variable": "gas"}
    with pytest.raises(RunError, match="the place of the plane on Earth"):
        nowhere.dafw.to_geojson(tmp_path / "map.geojson", "gas", 1.0)
    assert list(tmp_path.iterdir()) == []
