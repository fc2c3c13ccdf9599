"""Pictures of forecasts: they show the numbers."""

import numpy as np
import pytest
from matplotlib.tri import Triangulation
from xarray import Dataset

from dafw.views.forecasts import draw_forecast, draw_forecasts, plot_forecast, plot_reliability

SHARE = [0.5, 0.3, 0.2, *[0.0] * 8]
PROMISED = [0.0, 0.1, 0.22, *[None] * 8]
HAPPENED = [0.01, 0.2, 0.1, *[None] * 8]


def told(**changes):
    rows = [
        {"threshold": limit, "lead": lead, "share": SHARE, "promised": PROMISED, "happened": HAPPENED}
        for limit in (0.1, 0.5)
        for lead in (0.0, 30.0)
    ]
    areas = [
        {
            "threshold": limit,
            "n": [40, 3, *[0] * 8, 7],
            "promised": [0.0, 0.1, *[None] * 8, 1.0],
            "happened": [0.0, 0.3333, *[None] * 8, 0.9],
            "happened_interval": [[0.0, 0.1], [0.01, 0.9], *[None] * 8, [0.5, 1.0]],
        }
        for limit in (0.1, 0.5)
    ]
    usual = {"n_runs": 2, "issues": [10.0, 20.0], "horizon": 60.0, "reliability": rows, "areas": areas}
    return usual | changes


def test_a_reliability_diagram_shows_the_bins_that_have_forecasts():
    figure = plot_reliability(told(), "made")
    left, right = figure.axes[:2]
    lines = [line for line in left.get_lines() if line.get_gid() == "reliability"]
    assert len(figure.axes) == 4 and len(lines) == 2
    np.testing.assert_allclose(lines[0].get_xydata(), [[0.0, 0.01], [0.1, 0.2], [0.22, 0.1]])
    sizes = left.collections[0].get_sizes()
    assert sizes[0] > sizes[1] > sizes[2]
    (counts,) = right.child_axes
    assert [text.get_text() for text in counts.get_xticklabels()] == ["40", "3", "7"]
    assert "2 runs, 2 forecasts each" in figure._suptitle.get_text()


def test_without_areas_there_is_one_column(tmp_path):
    without = told()
    del without["areas"]
    assert len(plot_reliability(without, "made").axes) == 2
    (file,) = draw_forecasts({"made": without}, tmp_path)
    assert file.name == "forecast_reliability,made.png" and file.stat().st_size > 10_000


@pytest.fixture
def forecasts():
    side = np.linspace(0.0, 10.0, 6)
    nodes = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    chance = np.clip((nodes[:, 0] / 10.0)[np.newaxis] * np.array([[0.0], [0.5], [1.0]]), 0.0, 1.0)
    truth = np.stack([0.0 * nodes[:, 0], nodes[:, 0], nodes[:, 0]])
    return Dataset(
        {
            "exceedance_probability": (("issue", "lead", "threshold", "node"), chance[np.newaxis, :, np.newaxis]),
            "valid_time": (("issue", "lead"), [[5.0, 10.0, 15.0]]),
            "gas_truth": (
                ("issue", "lead", "node"),
                truth[np.newaxis],
            ),
            "mesh2d_face_nodes": (("face", "corner"), Triangulation(*nodes.T).triangles),
            "node_x": ("node", nodes[:, 0]),
            "node_y": ("node", nodes[:, 1]),
        },
        coords={"issue": [5.0], "lead": [0.0, 5.0, 10.0], "threshold": [5.0]},
        attrs={"scored_variable": "gas"},
    )


def test_a_forecast_has_a_map_for_each_lead_time_and_the_truth_where_it_has_a_contour(forecasts):
    figure = plot_forecast(forecasts)
    maps = [axes for axes in figure.axes if axes.get_title()]
    assert [axes.get_title() for axes in maps] == [
        "0 s ahead, t = 5 s",
        "5 s ahead, t = 10 s",
        "10 s ahead, t = 15 s",
    ]
    contours = [sum("TriContourSet" in type(one).__name__ for one in axes.collections) for axes in maps]
    assert contours == [0, 1, 1]
    assert figure._suptitle.get_text() == "forecast made at t = 5 s"


def test_the_maps_of_a_run_are_of_its_last_forecast(forecasts, tmp_path):
    forecasts.to_netcdf(tmp_path / "forecast.nc", engine="netcdf4")
    (file,) = draw_forecast(tmp_path)
    assert file == tmp_path / "figures" / "forecast.png" and file.stat().st_size > 10_000
    forecasts.isel(issue=[]).to_netcdf(tmp_path / "forecast.nc", engine="netcdf4")
    assert draw_forecast(tmp_path) == []
