"""The page of a study and of a multirun: its table, its seeds and where they lead, its curves."""

from __future__ import annotations

import json
import re
import shutil

import numpy as np
import pytest
from browser import number, open_page
from made_runs import made_study, make_run

from dafw.commands import main
from dafw.studies.many_runs import run_folder
from dafw.studies.report_files import write_page
from dafw.studies.results import write_results
from dafw.studies.study_page import page_of_study, results_of_study
from dafw.studies.study_table import cells
from dafw.studies.sweep_results import results_of_sweep

LAST = {"a": [10.0, 20.0, 60.0, 80.0], "b": [5.0, 6.0, 7.0, np.nan]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of a study with two configurations and four seeds, of which one run has failed."""
    folder = tmp_path_factory.mktemp("study")
    study = made_study(configurations={"a": [], "b": ["members=2"]}, title="Is <b> better?")
    for one in study.configurations:
        for seed, last in zip(study.seeds, LAST[one.name], strict=True):
            place = run_folder(folder, one, seed)
            if np.isnan(last):
                make_run(place, [100.0, 200.0], free=90.0, status="failed", error="the <wind>")
            else:
                make_run(place, np.linspace(100.0, last, 11), free=90.0)
    write_results(study, folder, pictures=False)
    return folder


def data_of(folder):
    results, summary = results_of_study(folder)
    return page_of_study(results, summary, folder, folder, "dafw study made"), summary


def test_the_data_are_those_of_the_study(folder):
    data, summary = data_of(folder)
    assert data["subtitle"] == "made · seeds 1 to 4 · 8 runs, 1 failed"
    assert [data["table"]["headings"], *data["table"]["rows"]] == cells(summary)
    groups = {group["name"]: group["points"] for group in data["seeds"]["groups"]}
    assert [point["err"] for point in groups["a"]] == LAST["a"]
    assert [point["err"] for point in groups["b"]] == [5.0, 6.0, 7.0, None] and groups["b"][3]["status"] == "failed"
    curves = {chart["title"]: chart for chart in data["curves"]}
    assert curves["a"]["lines"][0]["values"][-1] == pytest.approx(40.0), "the median of four seeds"
    assert curves["a"]["lines"][1]["values"] == [90.0] * 11
    low, high = (curves["a"]["bands"][0][side][-1] for side in ("low", "high"))
    assert (low, high) == pytest.approx((17.5, 65.0))
    assert data["failed"] == [["b, seed 4", "the <wind>"]]
    assert len({chart["top"] for chart in data["curves"]}) == 1


def test_the_command_that_repeats_a_study_is_the_one_that_was_given(folder, tmp_path):
    for name in ("study.nc", "summary.json"):
        shutil.copy(folder / name, tmp_path)
    words = ["made", "cycles=5", "--seeds", "1-4", "--configurations", "a*"]
    request = {"configurations": {}, "command": {"words": words, "working_folder": "/"}}
    (tmp_path / "request.json").write_text(json.dumps(request))
    shown = write_page(tmp_path).read_text(encoding="utf-8")
    assert '"command":"dafw study made cycles=5 --seeds 1-4 --configurations \'a*\'"' in shown


def test_the_page_leads_to_the_pages_of_runs_that_there_are(folder, browser):
    place = folder / "runs" / "a" / "seed=2"
    (place / "report.html").write_text("<!doctype html><title>a run</title>")
    page = open_page(browser, write_page(folder))
    assert page.text("#title") == "Is <b> better?"
    assert page.find("#table tbody tr").count() == 2 and page.find("#table tbody th").all_inner_texts() == ["a", "b"]
    assert page.find("#seeds circle").count() == 7 and page.find("#seeds path").count() == 1
    (link,) = page.find("#seeds a").all()
    assert link.get_attribute("href") == "runs/a/seed%3D2/report.html"
    assert "seed 2: ERR 20 %" in link.get_attribute("aria-label")
    places = {
        circle.locator("title").text_content(): float(circle.get_attribute("cx"))
        for circle in page.find("#seeds circle").all()
    }
    ordered = sorted(places, key=places.get)
    assert [number(text.split("ERR ")[1].split(" ")[0]) for text in ordered] == [5.0, 6.0, 7.0, 10.0, 20.0, 60.0, 80.0]
    page.go(10)
    assert page.find(".chart >> nth=0").locator(".legend b").all_inner_texts() == ["40\u202f%", "90\u202f%"]
    assert "the <wind>" in page.text("#words") and page.text("#command") == "dafw study made --seeds 1-4"
    page.tab.set_viewport_size({"width": 390, "height": 844})
    page.drawn()
    assert page.overflow() == 0 and page.complaints == []
    page.tab.context.close()
    (place / "report.html").unlink()


def test_a_page_elsewhere_leads_to_the_same_runs(folder, tmp_path):
    place = folder / "runs" / "a" / "seed=2" / "report.html"
    place.write_text("")
    results, summary = results_of_study(folder)
    data = page_of_study(results, summary, folder, tmp_path, "")
    address = data["seeds"]["groups"][0]["points"][1]["page"]
    assert (tmp_path / address.replace("%3D", "=")).resolve() == place.resolve()
    place.unlink()


def test_a_study_without_a_truth_has_its_table_only(tmp_path, browser):
    study = made_study()
    for seed in study.seeds:
        make_run(run_folder(tmp_path, study.configurations[0], seed), [np.nan, np.nan])
    write_results(study, tmp_path, pictures=False)
    data, _ = data_of(tmp_path)
    assert (data["curves"], data["seeds"]) == ([], None)
    page = open_page(browser, write_page(tmp_path))
    assert page.find("#table").is_visible() and page.find("#controls").is_hidden() and page.complaints == []
    page.tab.context.close()


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep")
    small = ["experiment=lorenz96", "pictures=false", "cycles=2", "model.spinup=10", "model.size=6"]
    words = [*small, "members=4,6", "seed=1000,1001"]
    assert main(["run", "-m", *words, f"hydra.sweep.dir={folder}"]) == 0
    return folder


def test_a_multirun_is_compared_like_a_study(sweep, capsys):
    results = results_of_sweep(sweep)
    assert results["configuration"].values.tolist() == ["members=4", "members=6"]
    for (row, column), place in np.ndenumerate(results["folder"].values):
        summary = json.loads((sweep / place / "summary.json").read_text())
        assert (summary["members"], summary["seed"]) == ([4, 6][row], [1000, 1001][column])
        assert summary["err_final"] == pytest.approx(float(results["err_final"][row, column]))
    assert main(["report", str(sweep), "--runs"]) == 0
    assert capsys.readouterr().out == f"{sweep / 'report.html'}\n"
    pages = sorted(sweep.rglob("report.html"))
    assert len(pages) == 5
    text = (sweep / "report.html").read_text()
    assert len(re.findall(r'"page":"[^"]+report.html"', text)) == 4
    assert "dafw run -m experiment=lorenz96" in text


@pytest.mark.parametrize("broken", ["study.nc", "summary.json"])
def test_a_study_that_cannot_be_read_is_named(folder, tmp_path, capsys, broken):
    for name in ("study.nc", "summary.json"):
        (tmp_path / name).write_bytes((folder / name).read_bytes() if name != broken else b"nothing")
    assert main(["report", str(tmp_path)]) == 2
    line = capsys.readouterr().err
    assert "cannot be read as a study" in line and line.count("\n") == 1


def test_what_is_not_there_is_not_taken_for_the_study_around_it(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    for name in ("nowhere", "elsewhere.nc"):
        assert main(["report", name]) == 2
        assert capsys.readouterr().err.startswith(f"dafw: {name}: holds no run")


def test_runs_are_asked_for_where_there_are_several(plain_run, capsys):
    assert main(["report", str(plain_run), "--runs"]) == 2
    assert "--runs is for a study or a multirun" in capsys.readouterr().err


@pytest.fixture
def plain_run(tmp_path):
    make_run(tmp_path / "one", [1.0, 2.0])
    return tmp_path / "one"
