"""What a page is made of: rounded fields, curves, texts that cannot become markup, one script; and the command."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dafw.commands import main
from dafw.core.domain import node_areas
from dafw.core.runs import open_run
from dafw.views import report_fields
from dafw.views.report_curves import curves_of, numbers, plain_units
from dafw.views.report_fields import kept_rows, packed, packed_fields, unpacked
from dafw.views.report_page import MAPS, as_json, bundle, colour_maps, page
from dafw.views.report_run import page_of_run, readings_of
from dafw.views.report_words import words_of

PAGE = Path(report_fields.__file__).parent / "page"


@pytest.mark.parametrize("bits", [8, 16])
@settings(max_examples=60, deadline=None)
@given(
    values=arrays(
        np.float32,
        st.tuples(st.integers(1, 4), st.integers(1, 6)),
        elements=st.floats(-1e6, 1e6, width=32) | st.just(np.nan),
    )
)
def test_a_packed_field_is_off_by_no_more_than_it_says(bits, values):
    field = packed(values, bits)
    back = unpacked(field)
    assert np.array_equal(np.isnan(back), np.isnan(values))
    known = np.isfinite(values)
    error = np.abs(back - values)[known].max(initial=0.0)
    scale = np.abs(values[known]).max(initial=0.0)
    assert error <= field["error"] * (1 + 1e-9) + 1e-12 * scale
    span = np.ptp(values[known]) if known.any() else 0.0
    assert field["error"] == pytest.approx(0.5 * span / (2**bits - 2))


def test_a_page_that_would_be_too_large_gets_fewer_bits_and_then_fewer_rows(monkeypatch):
    noise = np.random.default_rng(1000).standard_normal((33, 200))
    sizes = []
    for largest, bits, every in ((20_000, 16, 1), (11_000, 8, 1), (6_000, 8, 2), (2_000, 8, 8)):
        monkeypatch.setattr(report_fields, "LARGEST", largest)
        found, kept = packed_fields({"a": noise})
        assert (found["a"]["bits"], kept) == (bits, every)
        assert found["a"]["rows"] == len(kept_rows(33, every))
        np.testing.assert_allclose(unpacked(found["a"]), noise[kept_rows(33, every)], atol=found["a"]["error"] * 1.001)
        sizes.append(len(found["a"]["data"]))
        assert sizes[-1] <= largest
    monkeypatch.setattr(report_fields, "LARGEST", 10)
    assert packed_fields({"a": noise})[0]["a"]["rows"] == 2, "the ends stay, whatever they take"
    assert kept_rows(33, 8) == [0, 8, 16, 24, 32] and kept_rows(12, 8) == [0, 8, 11] and kept_rows(0, 1) == []


def test_the_integral_of_a_linear_field_is_exact(plant_run):
    x = plant_run["node_x"].values
    corners = plant_run["mesh2d_face_nodes"].values
    areas = node_areas(np.column_stack([x, plant_run["node_y"].values]), corners)
    middles, faces = x[corners].mean(axis=1), np.zeros(len(corners))
    for number, (a, b, c) in enumerate(corners):
        points = np.column_stack([x, plant_run["node_y"].values])[[a, b, c]]
        faces[number] = 0.5 * abs(np.linalg.det(points[1:] - points[0]))
    assert areas @ (3.0 + 2.0 * x) == pytest.approx(faces @ (3.0 + 2.0 * middles))


def test_curves_have_the_numbers_of_the_run(plant_run):
    charts = {chart["id"]: chart for chart in curves_of(plant_run)}
    lines = {line["role"]: line["values"] for line in charts["err"]["lines"]}
    np.testing.assert_allclose(lines["mean"], plant_run["err"], rtol=1e-5)
    np.testing.assert_allclose(lines["free"], plant_run["err_free"], rtol=1e-5)
    direction = {line["role"]: line["values"] for line in charts["wind_direction"]["lines"]}
    wrapped = np.radians(np.array(direction["mean"], float)) - plant_run["wind_direction_mean"].values
    np.testing.assert_allclose(np.cos(wrapped), 1.0, atol=1e-9)
    assert np.abs(np.diff(np.array(direction["mean"], float))).max() < 180.0
    band = charts["wind_speed"]["bands"][0]
    half = 0.5 * (np.array(band["high"]) - np.array(band["low"]))
    np.testing.assert_allclose(half, plant_run["wind_speed_spread"], rtol=1e-4)
    assert charts["total"]["title"] == "Gas on the site" and charts["total"]["units"] == "kg m⁻³ m²"


def test_the_band_of_a_positive_number_is_that_of_its_logarithm(plant_run):
    run = plant_run.copy(deep=True)
    run["wind_speed_mean"].attrs["comment"] = "positive: means are geometric, spreads are of the natural logarithm"
    (chart,) = [chart for chart in curves_of(run) if chart["id"] == "wind_speed"]
    low, high = (np.array(chart["bands"][0][side]) for side in ("low", "high"))
    np.testing.assert_allclose(low * high, run["wind_speed_mean"] ** 2, rtol=1e-4)
    assert (low > 0.0).all() and chart["log"]


def test_error_and_spread_of_a_positive_number_have_no_units(plant_run):
    plain = plant_run.assign(spread=plant_run["err"])
    run = plain.copy(deep=True)
    run["concentration_mean"].attrs["comment"] = "positive: means are geometric, spreads are of the natural logarithm"
    units = [chart["units"] for one in (plain, run) for chart in curves_of(one) if chart["id"] == "rmse"]
    assert units == ["kg m⁻³", ""]


def test_a_surprise_counts_both_errors(plant_run):
    found = readings_of(plant_run)
    row, entry = found["row"][3], 0
    where = np.flatnonzero(np.isfinite(plant_run["observation_value"].values[row]))[entry]
    value, mean, spread, variance = (
        float(plant_run[f"observation_{name}"][row, where])
        for name in ("value", "forecast_mean", "forecast_spread", "variance")
    )
    first = found["row"].index(row)
    assert found["surprise"][first] == pytest.approx((value - mean) / np.hypot(spread, np.sqrt(variance)), rel=1e-4)
    older = plant_run.drop_vars("observation_forecast_spread")
    assert set(readings_of(older)["surprise"]) == {None}


def test_the_page_data_are_strict_json_for_every_kind_of_run(plant_run, ring_run, lone_run, untold_run, tmp_path):
    for run in (plant_run, ring_run, lone_run, untold_run, plant_run.isel(time=[0])):
        data = page_of_run(run, tmp_path)
        assert json.loads(as_json(data)) == json.loads(json.dumps(data, allow_nan=False))
    assert numbers(np.array([1.23456789, np.nan, -np.inf])) == [1.23457, None, None]


@given(text=st.text())
@settings(max_examples=200, deadline=None)
def test_texts_in_the_data_cannot_become_markup(text):
    written = as_json({"text": text + "</script><!--"})
    assert not set("<>&") & set(written) and json.loads(written)["text"] == text + "</script><!--"


def test_a_title_and_a_mark_stay_what_they_are():
    shown = page({"title": "</title>{{SCRIPT}}&", "name": "{{STYLE}}"})
    assert "<title>&lt;/title&gt;{{SCRIPT}}&amp;</title>" in shown
    assert json.loads(shown.split('id="data">')[1].split("</script>")[0])["name"] == "{{STYLE}}"
    assert shown.count("<script") == 2 and shown.count("</script>") == 2
    assert "connect-src &#x27;self&#x27;" not in shown and "connect-src &#x27;none&#x27;" in shown


def test_the_scripts_have_every_module_once_and_ask_no_network():
    modules = {path.stem for path in PAGE.glob("*.js")}
    used = set()
    for entry in ("main", "place"):
        script = bundle(entry)
        found = re.findall(r"^modules\.(\w+) = ", script, re.MULTILINE)
        assert len(found) == len(set(found)) and entry in found
        used |= set(found)
        assert not re.search(r"^\s*(import|export)\b", script, re.MULTILINE)
        assert "</script" not in script and "<!--" not in script
    assert used == modules
    for name in modules:
        text = (PAGE / f"{name}.js").read_text()
        assert len(text.splitlines()) < 250 and text.startswith("// ")
        assert not re.search(r"innerHTML|insertAdjacentHTML|document\.write|eval\(|https?://(?!www\.w3\.org)", text), (
            name
        )


def test_colour_maps_grow_steadily_lighter_or_darker():
    import base64

    for name, text in colour_maps().items():
        if not name.startswith(MAPS):
            continue
        rgb = np.frombuffer(base64.b64decode(text), dtype=np.uint8).reshape(256, 3) / 255.0
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        luminance = linear @ [0.2126, 0.7152, 0.0722]
        steps = np.diff(luminance) * (-1.0 if name.endswith("light") else 1.0)
        assert steps.min() > -1e-3 and abs(luminance[-1] - luminance[0]) > 0.4, name


@pytest.mark.parametrize(
    ("units", "shown"),
    [("1", ""), ("m s-1", "m s⁻¹"), ("kg m-3", "kg m⁻³"), ("m2 s-1", "m² s⁻¹"), ("percent", "percent")],
)
def test_units_are_shown_as_people_write_them(units, shown):
    assert plain_units(units) == shown


def test_a_run_that_was_made_in_python_has_no_command(plant_run, tmp_path):
    words = words_of(plant_run, tmp_path)
    assert (words["command"], words["configuration"], words["status"]) == ("", "", "")
    (tmp_path / "summary.json").write_text('{"status": "failed", "error": "the wind", "cycles": 3, "cycles_wanted": 9}')
    words = words_of(plant_run, tmp_path)
    assert (words["status"], words["error"]) == ("failed", "the wind")
    assert ["cycles", "3 of 9"] in words["tables"][0]["rows"]


def test_the_command_prints_the_file(plant_folder, capsys, tmp_path):
    assert main(["report", str(plant_folder)]) == 0
    assert capsys.readouterr().out == f"{plant_folder / 'report.html'}\n"
    elsewhere = tmp_path / "some" / "where.html"
    assert main(["report", str(plant_folder / "run.nc"), "-o", str(elsewhere)]) == 0
    assert main(["report", str(plant_folder), str(plant_folder / "run.nc")]) == 0
    assert capsys.readouterr().out.splitlines()[-2:] == [str(plant_folder / "report.html")] * 2
    assert elsewhere.read_bytes() == (plant_folder / "report.html").read_bytes(), "the same run, the same bytes"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere"], "nowhere/run.nc: holds no run|nowhere: holds no run"),
        ([], "report: the following arguments are required: RUN"),
        (["{run}", "{run}", "-o", "page.html"], "--out is for one page, expected one RUN with it, got 2"),
        (["{run}", "-o", "{folder}"], "is a folder; expected the file to write"),
    ],
)
def test_a_wrong_request_is_one_line(words, said, plant_folder, capsys, tmp_path):
    asked = [word.format(run=plant_folder, folder=tmp_path) for word in words]
    assert main(["report", *asked]) == 2
    line = capsys.readouterr().err
    assert re.search(said, line) and line.count("\n") == 1


def test_the_command_of_a_run_names_the_folder_of_its_configuration(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my" / "experiment").mkdir(parents=True)
    mine = "# @package _global_\ndefaults: [linear_advection, _self_]\nname: mine\n"
    (tmp_path / "my" / "experiment" / "mine.yaml").write_text(mine)
    words = ["--config-dir", "my", "experiment=mine", "cycles=2", "pictures=false"]
    assert main(["run", *words, "hydra.run.dir=done"]) == 0
    with open_run(tmp_path / "done") as run:
        command = words_of(run, tmp_path / "done")["command"]
    assert command == "dafw run --config-dir my experiment=mine cycles=2 pictures=false"
    assert main([*command.split()[1:], "hydra.run.dir=again"]) == 0
