"""The map of a source's place: densities, regions and lines; and what sensors were expected to read."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from dafw.core.errors import RunError
from dafw.views import plot_expected, plot_places
from dafw.views.expected import read_by
from dafw.views.places import density, probability_within, rows_shown

RNG = np.random.default_rng(3)
NAMES = ["a from", "a to", "release"]
N = 400


def made_run(spreads=(30.0, 10.0, 1.0)):
    """Return a run whose members' places are normal about (50, 40), ever narrower."""
    normal = RNG.standard_normal((2, N))
    x, y = (centre + np.outer(spreads, normal[axis]) for axis, centre in enumerate((50.0, 40.0)))
    rows = len(spreads)
    values, sensors = np.full((rows, 2), np.nan), np.full((rows, 2), -1)
    values[1], values[2, 0] = [7.0, 8.0], 9.0
    sensors[1], sensors[2, 0] = [1, 0], 1
    return xr.Dataset(
        {
            "release_x_members": (("time", "member"), x),
            "release_y_members": (("time", "member"), y),
            "weight": (("time", "member"), np.full((rows, N), 1.0 / N)),
            "landmark_name": ("landmark", np.array(NAMES, dtype=object)),
            "landmark_x": ("landmark", [0.0, 100.0, 50.0]),
            "landmark_y": ("landmark", [0.0, 100.0, 41.0]),
            "filter_expected": (("time", "n"), np.arange(2.0 * rows).reshape(rows, 2)),
            "filter_background": (("time", "n"), np.ones((rows, 2))),
            "path_mean": ("time", np.ones(rows), {"units": "ppm"}),
            "observation_value": (("time", "observation"), values),
            "observation_sensor": (("time", "observation"), sensors),
            "sensor_name": ("sensor", np.array(["right", "left"], dtype=object)),
        },
        coords={"time": 60.0 * np.arange(rows)},
        attrs={"scored_variable": "path"},
    )


def told(run):
    run["filter_expected"].attrs["long_name"] = "what was expected of the sensors left, right"
    return run


def test_a_density_integrates_to_one_and_has_the_members_mean():
    places = RNG.normal([3.0, -2.0], [2.0, 0.5], (50, 2))
    weights = RNG.random(50)
    weights /= weights.sum()
    axis = np.linspace(-20.0, 20.0, 401)
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    levels = density(places, weights, points) * 0.01
    assert levels.sum() == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(levels @ points, weights @ places, atol=1e-6)


def test_the_region_of_a_normal_distribution_is_the_known_one():
    """Of a normal distribution, 1 - exp(-r^2 / 2) lies within r standard deviations."""
    run = made_run((1.0, 1.0, 1.0))
    for r in (0.5, 1.0, 2.0):
        found = probability_within(run, 0, np.array([50.0 + r, 40.0]))
        assert found == pytest.approx(1.0 - np.exp(-0.5 * r**2), abs=0.09)


def test_the_times_shown_are_those_of_equal_steps_in_spread():
    assert rows_shown(made_run((27.0, 20.0, 8.9, 8.9, 2.9, 1.0, 1.0))) == [2, 4, 6]


def test_a_map_shows_paths_and_the_true_place():
    figure = plot_places(made_run())
    axes = figure.axes[-1]
    drawn = {line.get_gid(): line for line in axes.get_lines()}
    np.testing.assert_array_equal(drawn["path"].get_xydata(), [[0.0, 0.0], [100.0, 100.0]])
    np.testing.assert_array_equal(drawn["release"].get_xydata(), [[50.0, 41.0]])
    np.testing.assert_allclose(drawn["mean"].get_xydata(), [[50.0, 40.0]], atol=0.3)
    assert axes.get_title() == "t = 120 s"
    told = [text.get_text() for text in figure.legends[0].get_texts()]
    assert told == ["likely places", "50 % lie inside", "90 %", "mean", "the source", "path of a sensor"]


def test_expected_readings_stand_beside_those_of_their_sensor():
    figure = plot_expected(told(made_run()))
    upper, lower = figure.axes
    lines = {line.get_gid(): line for line in upper.get_lines()}
    assert [axes.texts[0].get_text() for axes in (upper, lower)] == ["left", "right"]
    assert figure.get_supylabel() == "path (ppm)"
    np.testing.assert_array_equal(lines["expected"].get_ydata(), [0.0, 2.0, 4.0])
    np.testing.assert_array_equal(lines["read"].get_xydata(), [[60.0, 7.0], [120.0, 9.0]])
    (read,) = [line for line in lower.get_lines() if line.get_gid() == "read"]
    np.testing.assert_array_equal(read.get_xydata(), [[60.0, 8.0]])


def test_a_run_without_them_is_refused():
    with pytest.raises(RunError, match="release_x and release_y"):
        plot_places(made_run().drop_vars("release_x_members"))
    with pytest.raises(RunError, match="a filter with backgrounds"):
        plot_expected(made_run().drop_vars("filter_expected"))


def test_a_sensor_without_a_name_is_expected_too():
    run = made_run().drop_vars(["observation_sensor", "sensor_name"]).isel(n=[0])
    run["filter_expected"].attrs["long_name"] = "what was expected of the sensors 0"
    (axes,) = plot_expected(run).axes
    (dots,) = [line for line in axes.get_lines() if line.get_gid() == "read"]
    np.testing.assert_array_equal(dots.get_ydata(), [7.0, 8.0, 9.0])


def test_dropped_readings_are_not_drawn():
    run = made_run()
    run["observation_use"] = ("time", "observation"), np.zeros(run["observation_value"].shape, dtype=np.int8)
    run["observation_use"][1] = 2
    everything = [read_by(run, name)[1].tolist() for name in ("left", "right")]
    assert everything in ([[9.0], []], [[], [9.0]])
