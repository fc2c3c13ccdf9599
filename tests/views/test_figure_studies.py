"""Figures of a study: what is drawn is in the file; runs that failed are not forgotten; nothing is drawn of nothing."""

import numpy as np
import pytest
import xarray
from matplotlib.image import imread

from dafw.views.studies import BEYOND, draw_study, plot_best_and_worst, plot_study_errors, plot_success

TIME = np.arange(11.0)
ENDS = {"good": [10.0, 20.0, 30.0, 40.0], "mixed": [20.0, 80.0, 60.0, np.nan]}


@pytest.fixture
def study():
    """Two configurations, four seeds; the last run of the second has failed after five rows."""
    err = np.array([[np.linspace(100.0, end, TIME.size) for end in ends] for ends in ENDS.values()])
    err[1, 3] = np.where(TIME < 5.0, 100.0, np.nan)
    final = np.array(list(ENDS.values()))
    status = np.where(np.isfinite(final), "complete", "failed")
    since = np.array([[6.0, 7.0, 8.0, 9.0], [7.0, np.inf, np.inf, np.inf]])
    runs = ("configuration", "seed")
    return xarray.Dataset(
        {
            "err": ((*runs, "time"), err),
            "err_free": ((*runs, "time"), np.full_like(err, 150.0)),
            "err_final": (runs, final),
            "status": (runs, status),
            "time_to_success": (runs, since),
            "folder": (runs, np.full(final.shape, "none")),
        },
        {"configuration": list(ENDS), "seed": [1, 2, 3, 4], "time": TIME},
        {"success_below_percent": 50.0},
    )


def drawn(axes, gid):
    """Return the points of the lines with this name, (k, 2) each."""
    return [line.get_xydata() for line in axes.get_lines() if line.get_gid() == gid]


def test_the_median_and_the_free_run_are_those_of_the_file(study):
    figure = plot_study_errors(study)
    good, mixed = figure.axes
    assert [axes.get_title() for axes in (good, mixed)] == ["good", "mixed"]
    (median,) = drawn(good, "median")
    np.testing.assert_allclose(median, np.column_stack([TIME, np.linspace(100.0, 25.0, TIME.size)]))
    (median,) = drawn(mixed, "median")
    np.testing.assert_allclose(median[-1], [10.0, 70.0])  # of 20, 60, 80 and one that is above all
    for axes in (good, mixed):
        assert drawn(axes, "free")[0][-1].tolist() == [10.0, 150.0]
        assert {tuple(line.get_ydata()) for line in axes.get_lines() if line.get_gid() == "empty"} == {(100.0, 100.0)}
        assert axes.get_ylim()[0] == 0.0 and 150.0 < axes.get_ylim()[1] < 400.0


def test_success_rises_to_the_share_of_the_seeds(study):
    left, right = plot_success(study).axes
    good, mixed = drawn(left, "success")
    assert good[:, 1].tolist() == [0.0, 25.0, 50.0, 75.0, 100.0, 100.0] and good[1:5, 0].tolist() == [6, 7, 8, 9]
    assert mixed.tolist() == [[0.0, 0.0], [7.0, 25.0], [BEYOND, 25.0]]
    good, mixed = drawn(right, "success")
    assert good[1:5].tolist() == [[10.0, 25.0], [20.0, 50.0], [30.0, 75.0], [40.0, 100.0]]
    assert mixed[-1, 1] == 75.0  # not the one that failed
    assert left.get_xlim() == (0.0, 10.0)


def test_a_configuration_that_has_not_begun_is_an_empty_panel(study):
    study["status"][1] = "missing"
    study["err"][1] = np.nan
    study["err_free"][1] = np.nan
    figure = plot_study_errors(study)
    assert np.isnan(drawn(figure.axes[1], "median")[0][:, 1]).all()
    assert len(drawn(plot_success(study).axes[0], "success")) == 1


def test_the_best_and_the_worst_run_are_drawn_as_maps_where_they_have_one(plant_run, ring_run):
    maps = plot_best_and_worst({"best: seed 1": plant_run, "worst: seed 2": plant_run}, "mine")
    titles = [axes.get_title() for axes in maps.axes[:3]]
    error = float(plant_run["err"][-1])
    assert titles == ["truth", f"best: seed 1, ERR {error:.1f} %", f"worst: seed 2, ERR {error:.1f} %"]
    other = plant_run.copy(deep=True)
    other[f"{other.attrs['scored_variable']}_truth"][-1] += 0.1
    assert len(plot_best_and_worst({"best": plant_run, "worst": other}, "mine").axes) == 5  # two truths, a colour bar
    curves = plot_best_and_worst({"best": ring_run, "worst": ring_run}, "mine")
    np.testing.assert_array_equal(curves.axes[0].get_lines()[-1].get_ydata(), ring_run["err"])


def test_the_figures_are_written(study, plant_folder, tmp_path):
    study["folder"] = study["status"].dims, np.full(study["status"].shape, str(plant_folder))
    files = draw_study(study, tmp_path)
    assert [file.name for file in files] == ["err.png", "success.png", *(f"best_and_worst,{name}.png" for name in ENDS)]
    for file in files:
        pixels = imread(file)[..., :3]
        assert min(pixels.shape[:2]) > 300 and pixels.std() > 0.02
    assert draw_study(study.drop_vars("err"), tmp_path / "none") == [] and not (tmp_path / "none").exists()
