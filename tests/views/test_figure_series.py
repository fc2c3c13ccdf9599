"""Curves over time hold the file's numbers; angles do not jump."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from absent import without_free_run, without_truth

from dafw.core.errors import RunError
from dafw.views import plot_errors, plot_innovations, plot_parameters, plot_state
from dafw.views.contents import scalar_variables
from dafw.views.innovations import LATEST, recent
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


def test_without_a_free_run_nothing_is_dashed(plant_run):
    assert not lines(plot_errors({"belief": without_free_run(plant_run)}).axes[0], "free")
    assert not lines(plot_parameters(without_free_run(plant_run)).axes[0], "free")


def test_a_free_run_of_one_of_two_runs_is_that_runs(plant_run):
    axes = plot_errors({"with": plant_run, "without": without_free_run(plant_run)}).axes[0]
    (free,) = lines(axes, "free")
    assert free.get_color() == lines(axes, "err")[0].get_color()


def test_runs_without_a_truth_are_left_out_of_the_errors_and_keep_their_colour_for_other_pictures(
    plant_run, untold_run
):
    runs = {"untold": untold_run, "scored": plant_run}
    errors, innovations = plot_errors(runs), plot_innovations(runs)
    assert legend_texts(errors) == ["scored", "free run"]
    (err,) = lines(errors.axes[0], "err")
    assert err.get_color() == lines(innovations.axes[0], "recent")[1].get_color()
    with pytest.raises(RunError, match="needs a truth, which untold does not have"):
        plot_errors({"untold": untold_run})


def test_a_belief_that_was_revised_later_has_a_curve_of_its_own(plant_run):
    revised = plant_run.assign(err_smoothed=0.5 * plant_run["err"])
    figure = plot_errors({"belief": revised})
    (curve,) = lines(figure.axes[0], "smoothed")
    np.testing.assert_array_equal(curve.get_ydata(), revised["err_smoothed"])
    assert legend_texts(figure) == ["belief", "as revised later", "free run"]
    both = plot_errors({"filter": plant_run, "smoother": revised}).axes[0]
    assert lines(both, "smoothed")[0].get_color() == lines(both, "err")[1].get_color()


def test_innovations_are_drawn_cycle_by_cycle_and_of_the_latest_cycles_together(plant_run):
    figure = plot_innovations({"belief": plant_run})
    for axes, name, level in zip(figure.axes, ("innovation_rms", "innovation_mean"), (1.0, 0.0), strict=True):
        (dots,), (curve,), (honest,) = (lines(axes, gid) for gid in ("cycles", "recent", "honest"))
        np.testing.assert_array_equal(dots.get_ydata(), plant_run[name][1:])
        np.testing.assert_array_equal(curve.get_xdata(), plant_run["time"][1:])
        assert set(honest.get_ydata()) == {level}
    assert legend_texts(figure) == ["belief", "of an honest belief", "one cycle"]


def test_recent_innovations_count_every_reading_alike(plant_run):
    counts = np.resize([2, 0, 1], 50)
    drawn = np.random.default_rng(0).standard_normal((50, 2))
    innovations = np.where(np.arange(2) < counts[:, None], drawn, np.nan)
    silent = counts == 0
    innovations[silent] = np.nan
    with np.errstate(invalid="ignore"):
        sums = np.nansum(innovations, axis=1) / np.where(silent, np.nan, counts)
        squares = np.sqrt(np.nansum(innovations**2, axis=1) / np.where(silent, np.nan, counts))
    run = xr.Dataset(
        {
            "innovation_mean": ("time", sums),
            "innovation_rms": ("time", squares),
            "observation_forecast_mean": (("time", "observation"), innovations),
        }
    )
    for row in np.flatnonzero(~silent):
        latest = np.flatnonzero(~silent[: row + 1])[-LATEST:]
        seen = innovations[latest][np.isfinite(innovations[latest])]
        assert recent(run, "innovation_mean")[row] == pytest.approx(seen.mean())
        assert recent(run, "innovation_rms")[row] == pytest.approx(np.sqrt(np.mean(seen**2)))
    assert np.isnan(recent(run, "innovation_rms")[silent]).all()


def test_a_belief_that_expects_far_too_little_is_drawn_on_a_logarithmic_scale(plant_run):
    assert plot_innovations({"belief": plant_run}).axes[0].get_yscale() == "linear"
    wrong = plant_run.assign(innovation_rms=50.0 * plant_run["innovation_rms"])
    assert plot_innovations({"belief": wrong}).axes[0].get_yscale() == "log"


def test_innovations_of_runs_without_readings_are_refused(ring_run):
    with pytest.raises(RunError, match="needs readings, which ring does not have"):
        plot_innovations({"ring": ring_run})


def test_many_runs_stay_distinguishable(plant_run):
    axes = plot_errors({f"seed {index}": plant_run for index in range(10)}).axes[0]
    assert len({(line.get_color(), line.get_linestyle()) for line in lines(axes, "err")}) == 10


def test_parameters_have_one_panel_each_with_units(plant_run):
    panels = plot_parameters(plant_run).axes
    assert [axes.get_ylabel() for axes in panels] == ["wind speed (m s⁻¹)", "wind direction (°)"]
    np.testing.assert_array_equal(lines(panels[0], "mean")[0].get_ydata(), plant_run["wind_speed_mean"])
    assert len(lines(panels[0], "member")) == plant_run.sizes["member"]


def test_the_band_is_one_standard_deviation(plant_run):
    band = plot_parameters(plant_run).axes[0].collections[0].get_paths()[0].vertices
    mean, spread = plant_run["wind_speed_mean"].values, plant_run["wind_speed_spread"].values
    assert band[:, 1].max() == pytest.approx((mean + spread).max())
    assert band[:, 1].min() == pytest.approx((mean - spread).min())


def test_the_band_of_a_positive_variable_is_of_its_logarithm(plant_run):
    run = plant_run.copy()
    run["wind_speed_mean"] = run["wind_speed_mean"].assign_attrs(comment="positive: spreads are of the logarithm")
    (band,) = [patch for patch in plot_parameters(run).axes[0].collections if patch.get_gid() == "band"]
    mean, spread = run["wind_speed_mean"].values, run["wind_speed_spread"].values
    heights = band.get_paths()[0].vertices[:, 1]
    assert heights.max() == pytest.approx((mean * np.exp(spread)).max())
    assert heights.min() == pytest.approx((mean * np.exp(-spread)).min())


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


def test_parameters_without_a_truth_are_the_beliefs_alone(untold_run):
    figure = plot_parameters(untold_run)
    assert len(figure.axes) == 2
    assert legend_texts(figure) == ["members", "± spread", "belief"]
    turned = np.degrees(untold_run["wind_direction_mean"].values)
    drawn = lines(figure.axes[1], "mean")[0].get_ydata()
    np.testing.assert_allclose(np.cos(np.radians(drawn)), np.cos(np.radians(turned)), atol=1e-12)


def test_a_truth_of_another_kind_has_no_line_where_it_has_no_such_variable(plant_run):
    other = plant_run.copy(deep=True)
    other["wind_direction_truth"].values[:] = np.nan
    figure = plot_parameters(other)
    speed, direction = figure.axes
    assert len(lines(speed, "truth")) == 1 and not lines(direction, "truth")
    assert np.isfinite(lines(direction, "mean")[0].get_ydata()).all()
    assert np.isfinite(lines(direction, "free")[0].get_ydata()).all()
    assert "truth" in legend_texts(figure)


def test_the_mean_of_the_innovations_is_no_parameter(plant_run, ring_run):
    assert scalar_variables(plant_run) == ["wind_speed", "wind_direction"]
    assert scalar_variables(ring_run.assign(innovation_mean=ring_run["err"])) == []
    # `spread` is the name of a score; a number of the state may have it, too.
    named = {f"spread{stage}": plant_run["wind_speed_mean"] for stage in ("_mean", "_forecast_mean", "_spread")}
    assert scalar_variables(plant_run.assign(named)) == ["wind_speed", "wind_direction", "spread"]


def test_parameters_that_were_revised_later_are_drawn_beside_the_belief(plant_run):
    same = plant_run.assign(wind_speed_smoothed_mean=plant_run["wind_speed_mean"], err_smoothed=plant_run["err"])
    assert "as revised later" not in legend_texts(plot_parameters(same)), "nothing was revised"
    assert not lines(plot_errors({"one": same}).axes[0], "smoothed")
    figure = plot_parameters(plant_run.assign(wind_speed_smoothed_mean=plant_run["wind_speed_mean"] + 1.0))
    (revised,) = lines(figure.axes[0], "smoothed")
    np.testing.assert_array_equal(revised.get_ydata(), plant_run["wind_speed_mean"] + 1.0)
    assert not lines(figure.axes[1], "smoothed") and "as revised later" in legend_texts(figure)


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


def test_a_state_without_a_truth_is_the_belief_alone(ring_run):
    figure = plot_state(without_truth(ring_run))
    assert [axes.get_title() for axes in figure.axes[:-1]] == ["Belief"]
    belief = figure.axes[0].collections[0]
    np.testing.assert_array_equal(belief.get_array(), ring_run["x_mean"])
    assert belief.get_clim() == pytest.approx((float(ring_run["x_mean"].min()), float(ring_run["x_mean"].max())))
