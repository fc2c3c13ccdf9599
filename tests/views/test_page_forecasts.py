"""The forecasts of a run on its page: the latest at the time that is shown, by threshold and lead time; areas."""

from __future__ import annotations

import numpy as np
import pytest
from browser import differ, open_page
from made_forecasts import forecasts

from dafw.core.errors import RunError
from dafw.views.report import write_report
from dafw.views.report_fields import unpacked
from dafw.views.report_forecasts import forecasts_of


@pytest.fixture(scope="module")
def folder(plant_run, tmp_path_factory):
    place = tmp_path_factory.mktemp("run")
    plant_run.to_netcdf(place / "run.nc")
    forecasts(plant_run).to_netcdf(place / "forecast.nc")
    return place


@pytest.fixture(scope="module")
def page(browser, folder):
    opened = open_page(browser, write_report(folder))
    opened.find("#forecast").scroll_into_view_if_needed()
    yield opened
    assert opened.complaints == []


def row_at(run, time):
    return int(np.flatnonzero(run["time"].values == time)[0])


def test_the_latest_forecast_is_shown_and_none_before_the_first(page, plant_run):
    hint = page.find("#forecast .hint")
    page.go(0)
    assert hint.inner_text() == "The first forecast was made at t = 10 s."
    blank = page.pixels("#forecast canvas >> nth=0")
    assert not blank.any() and page.find("#forecast td").count() == 0
    seen = []
    for time, made in ((10.0, 10), (35.0, 10), (40.0, 40), (100.0, 40)):
        page.go(row_at(plant_run, time))
        assert hint.inner_text().startswith(f"Made at t = {made} s")
        seen.append(page.pixels("#forecast canvas >> nth=0"))
    assert differ(seen[0], seen[1]) == differ(seen[2], seen[3]) == 0.0
    assert differ(seen[1], seen[2]) > 0.02


def test_threshold_and_lead_time_are_chosen(page, plant_run):
    page.go(row_at(plant_run, 40.0))
    texts = {name: page.find(f"#forecast-{name} option").all_inner_texts() for name in ("threshold", "lead")}
    assert texts == {"threshold": ["0.01", "0.1"], "lead": ["0 s", "30 s"]}
    assert page.text("#forecast .choices label >> nth=0").startswith("Concentration above")
    covered = {}
    for lead in ("0", "1"):
        page.find("#forecast-lead").select_option(lead)
        for threshold in ("0", "1"):
            page.find("#forecast-threshold").select_option(threshold)
            page.drawn()
            drawn = page.pixels("#forecast canvas >> nth=0")
            covered[lead, threshold] = float(np.any(drawn[..., :3] < 0.9, axis=-1).mean())
    # Later it is further east, a higher threshold is exceeded on a smaller part of the site.
    assert covered["1", "0"] > covered["0", "0"] + 0.1 and covered["1", "1"] > covered["0", "1"]
    assert covered["0", "1"] < covered["0", "0"]
    assert page.find("#forecast figcaption span").inner_text() == "at t = 70 s"


def test_areas_have_their_probability_and_times_as_texts(page, plant_run):
    page.go(row_at(plant_run, 40.0))
    rows = [row.inner_text().split("\t") for row in page.find("#forecast tr").all()]
    assert rows[0] == ["Area", "Within 60 s", "By then: 10 %", "By then: 50 %"]
    assert rows[1:] == [["near & <b>dear</b>", "100 %", "1 s", "5 s"], ["far", "0 %", "–", "–"]]


def test_a_phone_shows_it_without_scrolling_sideways(browser, folder):
    opened = open_page(browser, folder / "report.html", viewport={"width": 390, "height": 844})
    assert opened.find("#forecast").is_visible() and opened.overflow() <= 0
    assert opened.find("#forecast-threshold").bounding_box()["width"] > 100.0, "its value can be read"
    opened.tab.close()


def test_a_run_without_forecasts_has_no_such_part(plant_run, tmp_path):
    assert forecasts_of(plant_run, tmp_path) is None


def test_the_maps_are_the_probabilities_and_keep_to_their_share_of_the_page(plant_run, tmp_path):
    issues = [10.0, 20.0, 30.0, 40.0, 50.0]
    made = forecasts(plant_run, issues)
    made.to_netcdf(tmp_path / "forecast.nc")
    whole = forecasts_of(plant_run, tmp_path)
    expected = made["exceedance_probability"].values.reshape(-1, plant_run.sizes["node"])
    assert np.abs(unpacked(whole["maps"]) - expected).max() <= 0.5 / 254 + 1e-6
    fewer = forecasts_of(plant_run, tmp_path, largest=len(whole["maps"]["data"]) - 1)
    assert (fewer["every"], fewer["issues"]) == (2, [10.0, 30.0, 50.0])
    assert len(fewer["areas"]["probability"]) == 3
    assert np.array_equal(unpacked(fewer["maps"])[-1], unpacked(whole["maps"])[-1])


def test_forecasts_that_cannot_be_read_are_named(plant_run, tmp_path):
    (tmp_path / "forecast.nc").write_bytes(b"no netCDF")
    with pytest.raises(RunError, match=r"forecast\.nc: cannot be read"):
        forecasts_of(plant_run, tmp_path)


@pytest.mark.parametrize("missing", ["issue", "exceedance_probability", "area_arrival_time"])
def test_a_file_that_a_run_is_just_making_is_no_reason_to_end(missing, plant_run, tmp_path):
    forecasts(plant_run).drop_vars(missing).to_netcdf(tmp_path / "forecast.nc")
    with pytest.raises(RunError, match=rf"forecast\.nc: .*{missing}"):
        forecasts_of(plant_run, tmp_path)
