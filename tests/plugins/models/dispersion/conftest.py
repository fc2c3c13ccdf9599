"""A small site: one tank in the middle of about 200 m x 150 m."""

import json

import numpy as np
import pytest

METRES_PER_DEGREE = 111_000.0


def square(lon, lat, half):
    """Return a GeoJSON building, a square of ``2 * half`` metres about a place (roughly)."""
    dx, dy = half / (METRES_PER_DEGREE * np.cos(np.radians(50.0))), half / METRES_PER_DEGREE
    ring = [
        [lon - dx, lat - dy],
        [lon + dx, lat - dy],
        [lon + dx, lat + dy],
        [lon - dx, lat + dy],
        [lon - dx, lat - dy],
    ]
    return {
        "type": "Feature",
        "properties": {"building": "yes", "name": "tank"},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }


@pytest.fixture(scope="session")
def small_site(tmp_path_factory):
    """The options of a site with one building."""
    file = tmp_path_factory.mktemp("site") / "tank.geojson"
    file.write_text(json.dumps({"type": "FeatureCollection", "features": [square(8.0, 50.0, 15.0)]}))
    return {"file": str(file), "bounds": [7.9986, 49.99933, 8.0014, 50.00067]}


@pytest.fixture(scope="session")
def small_model(small_site):
    """The options of a quick ad_ins model on the small site."""
    return {
        "site": small_site,
        "mesh": {"wall_size": 10.0, "far_size": 20.0, "transition": 30.0},
        "release": [50.0, 0.0],
        "release_radius": 15.0,
        "wind_speed": 3.0,
        "wind_speed_sd": 1.0,
        "wind_direction": 3.0,
        "wind_direction_sd": 0.5,
    }
