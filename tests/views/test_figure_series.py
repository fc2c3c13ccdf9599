"""Curves over time hold the file's numbers; angles do not jump."""

from __future__ import annotations

import numpy as np
import pytest

from dafw.core.errors import RunError
from dafw.views import plot_errors, plot_parameters, plot_state
from dafw.views.series import unwrap_near


def lines(axes, gid):
    return [line for line in axes.get_lines() if line.get_gid() == gid]


def legend_texts(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_errors_draw_each_run_and_one_shared_free_run(plant_run):
    other = plant_run.assign(err=plant_run["err"] * 0.5)
    figure = plot_errors({"θ = 0.0": plant_run, "θ = 0.3": other})
    axes = figure.axes[0]
    drawn = lines(axes, "err")
    np.testing.assert_array_equal(drawn[0].get_ydata(), plant_run["err"])
    np.testing.assert_array_equal(drawn[1].get_ydata(), other["err"])
    assert drawn[0].get_color() != drawn[1].get_color()
    (free,) = lines(axes, "free")
    np.testing.assert_array_equal(free.get_ydata(), plant_run["err_free"])
    assert free.get_linestyle() == "--"
    assert legend_texts(figure) == ["θ = 0.0", "θ = 0.3", "free run"]
    assert "%" in axes.get_ylabel() and "(s)" in axes.get_xlabel()


def test_an_interrupted_run_shares_the_free_run_of_the_longer_one(plant_run):
    figure = plot_errors({"cut": plant_run.isel(time=slice(0, 8)), "whole": plant_run})
    (free,) = lines(figure.axes[0], "free")
    assert free.get_xdata().size == plant_run.sizes["time"]
    assert [line.get_xdata().size for line in lines(figure.axes[0], "err")] == [8, plant_run.sizes["time"]]


def test_different_free_runs_are_drawn_in_their_runs_colours(plant_run):
    other = plant_run.assign(err_free=plant_run["err_free"] + 1.0)
    axes = plot_errors({"seed 0": plant_run, "seed 1": other}).axes[0]
    assert [line.get_color() for line in lines(axes, "free")] == [line.get_color() for line in lines(axes, "err")]


def test_a_missing_free_run_is_not_promised(lone_run):
    assert legend_texts(plot_errors({"belief": lone_run})) == ["belief"]
    assert "free run" not in legend_texts(plot_parameters(lone_run))


def test_many_runs_stay_distinguishable(plant_run):
    axes = plot_errors({f"seed {index}": plant_run for index in range(10)}).axes[0]
    assert len({(line.get_color(), line.get_linestyle()) for line in lines(axes, "err")}) == 10


def test_parameters_have_one_panel_each_with_units(plant_run):
    panels = plot_parameters(plant_run).axes
    assert [axes.get_ylabel() for axes in panels] == ["wind speed (m s$^{-1}$)", "wind direction (°)"]
    np.testing.assert_array_equal(lines(panels[0], "mean")[0].get_ydata(), plant_run["wind_speed_mean"])
    assert len(lines(panels[0], "member")) == plant_run.sizes["member"]


def test_the_band_is_one_standard_deviation(plant_run):
    band = plot_parameters(plant_run).axes[0].collections[0].get_paths()[0].vertices
    mean, spread = plant_run["wind_speed_mean"].values, plant_run["wind_speed_spread"].values
    assert band[:, 1].max() == pytest.approx((mean + spread).max())
    assert band[:, 1].min() == pytest.approx((mean - spread).min())


def test_angles_do_not_jump_where_they_wrap(plant_run):
    time = plant_run["time"].values
    turning = np.radians(350.0 + 0.5 * time)
    run = plant_run.copy()
    run["wind_direction_truth"].values[:] = turning % (2 * np.pi)
    run["wind_direction_free"].values[:] = np.radians(10.0)
    run["wind_direction_mean"].values[:] = (turning + np.radians(15.0)) % (2 * np.pi)
    run["wind_direction_members"].values[:] = (turning[:, None] - np.radians(np.arange(10.0))) % (2 * np.pi)
    axes = plot_parameters(run).axes[1]
    np.testing.assert_allclose(lines(axes, "truth")[0].get_ydata(), 350.0 + 0.5 * time)
    np.testing.assert_allclose(lines(axes, "mean")[0].get_ydata(), 365.0 + 0.5 * time)
    np.testing.assert_allclose(lines(axes, "free")[0].get_ydata(), 370.0)
    np.testing.assert_allclose(lines(axes, "member")[4].get_ydata(), 346.0 + 0.5 * time)


def test_unwrapped_angles_begin_near_the_start_and_stay_the_same_angles():
    angles = np.array([0.1, 6.2, 6.0, 0.3])
    near = unwrap_near(angles, 20.0)
    assert abs(near[0] - 20.0) <= np.pi
    assert np.max(np.abs(np.diff(near))) < np.pi
    np.testing.assert_allclose(np.exp(1j * near), np.exp(1j * angles))


def test_parameters_of_a_state_without_scalars_are_refused(ring_run):
    with pytest.raises(RunError, match="scalar state variable"):
        plot_parameters(ring_run)


def test_state_pictures_hold_truth_and_belief_on_one_scale(ring_run):
    figure = plot_state(ring_run)
    truth, belief = (axes.collections[0] for axes in figure.axes[:2])
    np.testing.assert_array_equal(truth.get_array(), ring_run["x_truth"])
    np.testing.assert_array_equal(belief.get_array(), ring_run["x_mean"])
    assert truth.get_clim() == belief.get_clim()
    assert truth.get_clim()[0] == pytest.approx(float(ring_run["x_truth"].min()))
