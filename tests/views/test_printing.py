"""Pictures for print: exact widths in every format, the same bytes twice, and maps at chosen times."""

from __future__ import annotations

import re

import matplotlib
import numpy as np
import pytest
from absent import without_truth
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text

from dafw.commands import main
from dafw.core.errors import ConfigurationError, RunError
from dafw.views import (
    draw_runs,
    plot_contours,
    plot_errors,
    plot_innovations,
    plot_parameters,
    plot_route,
    plot_times,
)
from dafw.views.files import save
from dafw.views.printing import EDGE, Paper, _pixels, _with_edges, fit
from dafw.views.style import RESOLUTION
from dafw.views.times import difference_scale, rows_at


def fields(figure):
    """Return the mappable of every panel, row by row."""
    return [axes.collections[0] for axes in figure.axes if axes.get_label() != "<colorbar>"]


def test_maps_at_chosen_times_have_the_values_of_the_run(plant_run):
    figure = plot_times(plant_run, [25.0, 100.0])
    drawn = [field.get_array() for field in fields(figure)]
    truth, belief = (plant_run[f"concentration_{key}"].values for key in ("truth", "mean"))
    for row, (first, second, third) in zip((5, 20), (drawn[:3], drawn[3:]), strict=True):
        np.testing.assert_array_equal(first, truth[row])
        np.testing.assert_array_equal(second, belief[row])
        np.testing.assert_array_equal(third, belief[row] - truth[row])
    norms = [field.norm for field in fields(figure)]
    assert norms[0] is norms[1] is norms[3] is norms[4] and norms[2] is norms[5] and norms[0].vmin == 0.0
    assert norms[2].vmax == -norms[2].vmin >= np.abs((belief - truth)[[5, 20]]).max()
    assert [axes.get_title() for axes in figure.axes[:3]] == ["Truth", "Belief", "Belief minus truth"]
    assert [figure.axes[k].get_ylabel() for k in (0, 3)] == ["t = 25 s", "t = 100 s"]
    assert f"ERR {float(plant_run['err'][5]):.3g} %" in [text.get_text() for text in figure.findobj(Text)]
    way = next(line for line in figure.axes[0].get_lines() if line.get_gid() == "route")
    np.testing.assert_array_equal(way.get_xdata(), plant_run["vehicle_x"].values[:6, 0])


def test_without_a_truth_there_is_the_spread(plant_run):
    figure = plot_times(without_truth(plant_run), [50.0])
    assert [axes.get_title() for axes in figure.axes[:2]] == ["Belief", "Spread of the belief"]
    np.testing.assert_array_equal(fields(figure)[1].get_array(), plant_run["concentration_spread"].values[10])


def test_a_time_without_a_map_is_refused(plant_run, ring_run):
    assert rows_at(plant_run, [0.0, 5.0, 100.0]) == [0, 1, 20]
    with pytest.raises(ConfigurationError, match=r"no map at t = 33 s; the nearest is 35"):
        rows_at(plant_run, [33.0])
    ends = plant_run.copy(deep=True)
    ends["concentration_mean"][1:-1] = np.nan
    with pytest.raises(ConfigurationError, match="the nearest is 100"):
        rows_at(ends, [60.0])
    with pytest.raises(RunError, match="need a field on a mesh"):
        plot_times(ring_run, [0.0])


@pytest.mark.parametrize(("largest", "end"), [(0.0, 1.0), (0.19, 0.2), (0.31, 0.5), (7.0, 10.0), (2.0, 2.0)])
def test_the_scale_of_differences_ends_at_a_round_number(largest, end):
    scale = difference_scale(np.array([0.0, -largest]))
    assert (scale.norm.vmin, scale.norm.vmax) == (-end, end)
    assert np.ptp(scale.colours(scale.norm(0.0))[:3]) < 0.02, "zero has no colour"


@pytest.mark.parametrize("width", [85.0, 300.0])
def test_a_picture_is_as_wide_as_it_was_asked_for(plant_run, tmp_path, width):
    for name, kind in (("one", "png"), ("two", "pdf"), ("three", "svg")):
        save(plot_parameters(plant_run), tmp_path / f"{name}.{kind}", Paper(kind, width))
    inches = width / 25.4
    assert abs(imread(tmp_path / "one.png").shape[1] - 300 * inches) <= 1
    box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ", (tmp_path / "two.pdf").read_bytes())
    assert float(box[1]) == pytest.approx(72 * inches, abs=0.01)
    svg = re.search(r'<svg [^>]*width="([\d.]+)pt"', (tmp_path / "three.svg").read_text())
    assert float(svg[1]) == pytest.approx(72 * inches, abs=0.01)


def test_empty_edges_of_a_map_are_cut_off(plant_run, tmp_path):
    figure = plot_route({"belief": plant_run})
    pixels = imread(save(figure, tmp_path / "route.png"))
    assert pixels.shape[2] == 3, "without a fourth number, which says how transparent a picture is"
    drawn = (pixels != 1.0).any(axis=2)
    for axis in (0, 1):
        inked = drawn.any(axis=1 - axis).nonzero()[0]
        assert inked[0] == drawn.shape[axis] - 1 - inked[-1] == round(EDGE * RESOLUTION)
    whole = _pixels(plot_route({"belief": plant_run}), RESOLUTION)
    inked = (whole != 255).any(axis=2)
    rows, columns = (np.flatnonzero(inked.any(axis=axis)) for axis in (1, 0))
    edge = round(EDGE * RESOLUTION)
    np.testing.assert_array_equal(
        np.round(255 * pixels[edge:-edge, edge:-edge]).astype(np.uint8),
        whole[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1],
    )


@pytest.mark.parametrize(
    ("settings", "ground"),
    [
        ({}, [255, 255, 255]),
        ({"figure.facecolor": "none"}, [255, 255, 255]),
        ({"figure.facecolor": (0.0, 0.0, 0.0, 0.2)}, [204, 204, 204]),
        ({"figure.facecolor": "0.2"}, [51, 51, 51]),
        ({"figure.facecolor": "0.2", "savefig.facecolor": "white"}, [255, 255, 255]),
    ],
)
def test_the_ground_of_a_picture_is_as_matplotlib_is_told(settings, ground, tmp_path):
    with matplotlib.rc_context(settings):
        figure = Figure(figsize=(1.0, 1.0))
        before = figure.canvas, figure.get_facecolor(), figure.dpi
        figure.text(0.5, 0.5, "text", fontsize=20, ha="center")
        pixels = _pixels(figure, 100)
        assert pixels.shape == (100, 100, 3) and pixels[0, 0].tolist() == ground
        assert (figure.canvas, figure.get_facecolor(), figure.dpi) == before
        if ground == [255, 255, 255]:  # as savefig draws it, to the rounding of what is half transparent
            figure.savefig(tmp_path / "saved.png", dpi=100, facecolor="white")
            saved = np.round(255 * imread(tmp_path / "saved.png")[..., :3]).astype(int)
            assert np.abs(saved - pixels).max() <= 2


def test_a_picture_with_nothing_on_it_stays_as_it_is():
    empty = np.full((4, 5, 3), 255, dtype=np.uint8)
    np.testing.assert_array_equal(_with_edges(empty, 1), empty)


def test_what_is_said_in_a_column_stays_inside_and_can_be_read(plant_run):
    one = {"belief": plant_run}
    figures = [plot_contours(plant_run), plot_times(plant_run, [25.0, 50.0])]
    figures += [plot_parameters(plant_run), *(draw(one) for draw in (plot_errors, plot_innovations, plot_route))]
    for figure in figures:
        fit(figure, 85.0)
        figure.draw_without_rendering()
        for text in figure.findobj(Text):
            if text.get_text().strip() and text.get_visible():
                assert text.get_fontsize() >= 5.5
        outside = figure.legends + [axes.title for axes in figure.axes if axes.get_title()]
        for part in outside:
            extent = part.get_window_extent()
            assert extent.x0 >= -1.0 and extent.x1 <= figure.bbox.width + 1.0, part


def test_the_same_run_gives_the_same_bytes_in_every_format(plant_run, tmp_path):
    for kind in ("png", "pdf", "svg"):
        paper = Paper(kind, 85.0)
        once, again = (save(plot_errors({"a": plant_run}), tmp_path / f"{k}.{kind}", paper) for k in ("once", "again"))
        assert once.read_bytes() == again.read_bytes()


def test_all_pictures_have_the_format(ring_run, tmp_path):
    ring_run.to_netcdf(tmp_path / "run.nc")
    files = draw_runs([tmp_path], None, Paper("svg"))
    assert [file.name for file in files] == ["err.svg", "state.svg"]


def test_the_command_draws_for_print(plant_folder, capsys):
    assert main(["plot", str(plant_folder), "--format", "pdf", "--width", "85", "--times", "25,50"]) == 0
    assert capsys.readouterr().out == f"{plant_folder / 'figures' / 'maps.pdf'}\n"


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--format", "jpg"], "expected a format of png, pdf, svg"),
        (["--width", "3"], "expected a width between 40 and 1000 mm"),
        (["--width", "nan"], "expected a width between"),
        (["--times", "x"], "expected times in s such as 30,60"),
        (["--times", "nan"], "expected times in s such as 30,60"),
        (["--times", "33"], "no map at t = 33 s"),
    ],
)
def test_wrong_requests_are_one_line(plant_folder, capsys, words, problem):
    assert main(["plot", str(plant_folder), *words]) == 2
    error = capsys.readouterr().err
    assert problem in error and error.count("\n") == 1 and not (plant_folder / "figures").exists()


def test_maps_of_several_runs_are_refused(plant_run, plant_folder, tmp_path, capsys):
    (tmp_path / "other").mkdir()
    plant_run.assign_attrs(name="other").to_netcdf(tmp_path / "other" / "run.nc")
    assert main(["plot", str(plant_folder), str(tmp_path / "other"), "--times", "50"]) == 2
    assert "--times draws the maps of one run, got 2 runs" in capsys.readouterr().err
