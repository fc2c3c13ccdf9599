"""Maps and sections show the file's values at their places; buildings stay blank."""

from __future__ import annotations

import numpy as np
import pytest
from absent import without_free_run, without_truth
from matplotlib.collections import PolyCollection
from matplotlib.tri import LinearTriInterpolator

from dafw.core.errors import RunError
from dafw.views import plot_contours, plot_route, plot_section
from dafw.views.contents import buildings, polyline, triangulation
from dafw.views.section import SectionWeights, sample_polyline
from dafw.views.style import colour_scale, peak_at_end, spread_scale


def lines(axes, gid):
    return [line for line in axes.get_lines() if line.get_gid() == gid]


def fields(figure):
    """The mappable of every panel, first drawn first."""
    return [axes.collections[0] for axes in figure.axes if axes.get_label() != "<colorbar>"]


def test_route_is_the_files_route_and_nodes(plant_run):
    axes = plot_route({"one": plant_run}).axes[0]
    (route,) = lines(axes, "route")
    np.testing.assert_array_equal(route.get_xdata(), plant_run["vehicle_x"][:, 0])
    np.testing.assert_array_equal(route.get_ydata(), plant_run["vehicle_y"][:, 0])
    (nodes,) = lines(axes, "nodes")
    read = plant_run["observation_node"].values.ravel()
    read = read[read >= 0]
    np.testing.assert_array_equal(nodes.get_xdata(), plant_run["node_x"].values[read])
    np.testing.assert_array_equal(nodes.get_ydata(), plant_run["node_y"].values[read])
    ends = [lines(axes, gid)[0].get_xydata()[0] for gid in ("start", "end")]
    np.testing.assert_array_equal(ends, route.get_xydata()[[0, -1]])
    (release,) = [line for line in axes.get_lines() if line.get_label() == "release"]
    np.testing.assert_array_equal(release.get_xydata(), [[560.0, 340.0]])
    assert axes.get_aspect() == 1.0


def test_route_background_is_the_first_runs_belief_at_the_end(plant_run, make_plant):
    figure = plot_route({"one": plant_run, "two": make_plant(learning=60.0)})
    np.testing.assert_array_equal(fields(figure)[0].get_array(), plant_run["concentration_mean"][-1])
    assert "one" in figure.axes[0].get_title()
    assert len(lines(figure.axes[0], "route")) == 2


def test_every_vehicle_has_its_own_route(plant_run):
    import xarray as xr

    two = xr.concat([plant_run[["vehicle_x", "vehicle_y"]]] * 2, "vehicle", join="override")
    both = plant_run.drop_vars(["vehicle_x", "vehicle_y", "policy_sector_score"]).assign(
        two[["vehicle_x", "vehicle_y"]]
    )
    axes = plot_route({"pair": both}).axes[0]
    assert [len(lines(axes, gid)) for gid in ("route", "start", "end")] == [2, 2, 2]


def test_stations_without_a_vehicle_are_drawn_as_nodes_only(lone_run):
    figure = plot_route({"stations": lone_run})
    axes = figure.axes[0]
    assert len(lines(axes, "nodes")) == 1 and not lines(axes, "route") and not lines(axes, "start")
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["readings", "release"]


def titles(figure):
    return [axes.get_title() for axes in figure.axes if axes.get_title()]


@pytest.mark.parametrize("absent", ["holds NaN", "is not there"])
def test_maps_without_a_free_run_leave_its_panel_out(lone_run, plant_run, absent):
    run = lone_run if absent == "holds NaN" else without_free_run(plant_run)
    contours, section = plot_contours(run), plot_section(run)
    ends = f"t = {float(run['time'][-1]):g} s"
    assert titles(contours)[:2] == ["Truth, t = 0 s", f"Truth, {ends}"]
    assert [title.split(" (")[0] for title in titles(contours)[2:]] == [f"Belief, {ends}"]
    assert titles(section) == ["Truth", "Belief"]
    np.testing.assert_array_equal(fields(contours)[2].get_array(), run["concentration_mean"][-1])


def test_without_a_truth_the_belief_is_drawn_at_both_ends_and_how_sure_it_is(untold_run, plant_run):
    figure = plot_contours(untold_run)
    assert titles(figure) == ["Belief, t = 0 s", "Belief, t = 100 s", "Spread of the belief, t = 100 s"]
    first, last, spread = fields(figure)[:3]
    mean = untold_run["concentration_mean"]
    np.testing.assert_array_equal(first.get_array(), mean[0])
    np.testing.assert_array_equal(last.get_array(), mean[-1])
    np.testing.assert_array_equal(spread.get_array(), untold_run["concentration_spread"][-1])
    assert first.get_clim() == last.get_clim() == (0.0, float(mean[-1].max()))
    assert spread.get_clim() == (0.0, float(untold_run["concentration_spread"][-1].max()))
    with_free = plot_contours(without_truth(plant_run))
    assert titles(with_free)[2:] == ["Free run, t = 100 s", "Spread of the belief, t = 100 s"]


def test_a_section_without_a_truth_is_scaled_by_the_belief(untold_run, plant_run):
    (panel,) = fields(plot_section(untold_run))
    assert titles(plot_section(untold_run)) == ["Belief"]
    assert titles(plot_section(without_truth(plant_run))) == ["Free run", "Belief"]
    along = np.ma.filled(panel.get_array(), np.nan)
    assert panel.get_clim() == (0.0, pytest.approx(np.nanpercentile(along, 99.9)))


def test_the_spread_of_a_positive_variable_is_named_for_what_it_is(untold_run):
    def bar(run):
        (spread,) = [child for axes in plot_contours(run).axes for child in axes.child_axes]
        return spread.get_ylabel()

    positive = untold_run.copy()
    positive["concentration_mean"] = positive["concentration_mean"].assign_attrs(comment="positive: and so on")
    assert bar(untold_run) == "standard deviation of concentration (kg m⁻³)"
    assert bar(positive) == "standard deviation of the logarithm of concentration"


def test_a_belief_that_is_sure_has_a_spread_that_can_be_drawn():
    assert (spread_scale(np.zeros(3)).norm.vmin, spread_scale(np.zeros(3)).norm.vmax) == (0.0, 1.0)


def test_contours_are_the_papers_four_panels_on_one_scale(plant_run):
    figure = plot_contours(plant_run)
    panels = fields(figure)
    expected = [("truth", 0), ("truth", -1), ("free", -1), ("mean", -1)]
    for panel, (suffix, index) in zip(panels, expected, strict=True):
        np.testing.assert_array_equal(panel.get_array(), plant_run[f"concentration_{suffix}"][index])
        assert panel.get_clim() == (0.0, float(plant_run["concentration_truth"][-1].max()))
    assert "kg m" in figure.axes[-1].get_ylabel()
    for axes in figure.axes[:4]:
        (gamma,) = lines(axes, "section")
        np.testing.assert_array_equal(gamma.get_xydata(), polyline(plant_run, "section"))
        outlines = next(c for c in axes.collections if type(c) is PolyCollection)
        assert len(outlines.get_paths()) == plant_run.sizes["obstacle"]


def test_contours_without_section_and_buildings(make_plant):
    open_field = make_plant(rows=0, columns=0).drop_vars(["section_x", "section_y"])
    figure = plot_contours(open_field)
    assert not lines(figure.axes[0], "section")
    assert buildings(open_field) == []


def test_building_outlines_are_split_by_their_counts(plant_run):
    outlines = buildings(plant_run)
    assert [len(outline) for outline in outlines] == plant_run["obstacle_vertex_count"].values.tolist()
    np.testing.assert_array_equal(np.vstack(outlines), polyline(plant_run, "obstacle"))


def test_samples_lie_on_the_polyline_at_equal_arc_length():
    arc_length, points = sample_polyline(np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 40.0]]), 8)
    np.testing.assert_allclose(arc_length, np.arange(8) * 10.0)
    np.testing.assert_allclose(points[[0, 3, 5, 7]], [[0, 0], [30, 0], [30, 20], [30, 40]])


def test_section_of_a_linear_field_is_exact_and_blank_in_buildings(plant_run):
    mesh = triangulation(plant_run)
    middle = buildings(plant_run)[5].mean(axis=0)
    across = np.array([[60.0, middle[1]], [middle[0], middle[1]], [700.0, middle[1] + 20.0]])
    _, points = sample_polyline(across, 301)
    slope = np.array([[0.3, -0.2], [1.0, 4.0]])
    values = SectionWeights(mesh, points).apply(slope @ np.vstack([mesh.x, mesh.y]) + 2.0)
    inside = np.isfinite(values[0])
    np.testing.assert_allclose(values[:, inside], (slope @ points.T + 2.0)[:, inside], rtol=1e-12)
    assert not inside[np.argmin(np.linalg.norm(points - middle, axis=1))]
    assert inside[0] and inside[-1]


def test_section_agrees_with_matplotlibs_interpolator(plant_run):
    mesh, field = triangulation(plant_run), plant_run["concentration_truth"].values
    _, points = sample_polyline(polyline(plant_run, "section"), 101)
    values = SectionWeights(mesh, points).apply(field)
    expected = LinearTriInterpolator(mesh, field[7])(*points.T)
    np.testing.assert_array_equal(np.isnan(values[7]), expected.mask)
    np.testing.assert_allclose(values[7][~expected.mask], expected.compressed(), atol=1e-14)


def test_section_outside_the_mesh_is_blank(plant_run):
    values = SectionWeights(triangulation(plant_run), np.array([[-5.0, 300.0], [400.0, 900.0]])).apply(
        np.ones((1, 9999))
    )
    assert np.isnan(values).all()


def test_section_picture_has_time_across_and_arc_length_up(plant_run):
    figure = plot_section(plant_run)
    truth, free, belief = fields(figure)
    assert truth.get_clim() == free.get_clim() == belief.get_clim()
    _, points = sample_polyline(polyline(plant_run, "section"), truth.get_array().shape[0])
    expected = SectionWeights(triangulation(plant_run), points).apply(plant_run["concentration_mean"].values)
    np.testing.assert_array_equal(np.ma.filled(belief.get_array(), np.nan), expected.T)
    length = np.linalg.norm(np.diff(polyline(plant_run, "section"), axis=0), axis=1).sum()
    low, high = figure.axes[0].get_ylim()
    assert low <= 0.0 and high == pytest.approx(length, rel=0.01)


def test_section_is_refused_where_there_is_none(plant_run, ring_run):
    for run in (plant_run.drop_vars(["section_x", "section_y"]), plant_run.isel(time=[0]), ring_run):
        with pytest.raises(RunError, match="section"):
            plot_section(run)


def test_maps_of_a_state_without_coordinates_are_refused(ring_run):
    with pytest.raises(RunError, match="field on a mesh"):
        plot_route({"ring": ring_run})
    with pytest.raises(RunError, match="field on a mesh"):
        plot_contours(ring_run)


def test_colours_follow_a_decaying_peak_but_do_not_blow_up_what_is_left():
    decaying = np.array([[1.0, 0.0], [0.5, 0.0], [0.3, 0.0]])
    assert peak_at_end(decaying) == 0.3
    assert peak_at_end(np.array([[1.0], [0.001]])) == 0.05
    assert colour_scale(decaying, 0.3, decaying).extend == "max"
    assert colour_scale(decaying, 0.3, decaying[-1]).extend == "neither"


def test_undershoots_keep_the_scale_of_a_concentration_and_signed_fields_their_own():
    assert colour_scale(np.array([-0.1, 1.0]), 1.0).norm.vmin == 0.0
    assert colour_scale(np.array([-4.0, 8.0]), 8.0).norm.vmin == -4.0
    assert colour_scale(np.zeros(3), 0.0, np.zeros(3)).norm.vmax == 1.0
