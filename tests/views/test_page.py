"""The page of a run in a real browser: it plays, it answers to keys and clicks, and it asks nothing of any network."""

from __future__ import annotations

import base64

import numpy as np
import pytest
from absent import without_truth
from browser import differ, number, open_page
from matplotlib.image import imread
from matplotlib.tri import LinearTriInterpolator
from playwright.sync_api import expect

from benchmarks.page import measured, picture
from dafw.views.contents import triangulation
from dafw.views.report import write_report
from dafw.views.report_page import colour_maps
from dafw.views.report_run import fields_of

PHONE = {"viewport": {"width": 390, "height": 844}, "device_scale_factor": 2, "is_mobile": True, "has_touch": True}


@pytest.fixture(scope="module")
def show(browser, tmp_path_factory):
    """Return a function that writes the page of a dataset and opens it."""

    def shown(run, **options):
        folder = tmp_path_factory.mktemp("run")
        run.to_netcdf(folder / "run.nc")
        return open_page(browser, write_report(folder), **options)

    return shown


@pytest.fixture(scope="module")
def plant_page(show, plant_run):
    return show(plant_run)


@pytest.fixture
def page(plant_page):
    """Return the page of the plant as it opens, and check afterwards that the browser had nothing to say of it."""
    plant_page.tab.reload()
    plant_page.tab.wait_for_selector("html[data-ready]")
    plant_page.drawn()
    yield plant_page
    assert plant_page.complaints == []


def at_place(page, key, x, y, run):
    """Click a place (m) on the map of a stage."""
    box = page.find(f".map[data-key={key}] .layers").bounding_box()
    mesh = triangulation(run)
    left, right, bottom, top = mesh.x.min(), mesh.x.max(), mesh.y.min(), mesh.y.max()
    right_of, below = (x - left) / (right - left), (top - y) / (top - bottom)
    page.tab.mouse.click(box["x"] + right_of * box["width"], box["y"] + below * box["height"])
    page.drawn()


def test_it_opens_from_a_disk_and_asks_for_nothing(page):
    assert {request.split(":")[0] for request in page.requests} <= {"file", "data"}
    assert len({request for request in page.requests if request.startswith("file")}) == 1
    assert page.find(".map figcaption").all_inner_texts()[0] == "Truth"
    assert [key.get_attribute("data-key") for key in page.find(".map").all()] == ["truth", "mean", "free", "spread"]
    charts = [key.get_attribute("data-id") for key in page.find(".chart").all()]
    assert {"err", "wind_speed", "wind_direction", "total", "innovation_rms", "ranks", "scores"} <= set(charts)
    assert "where it blows to" in page.text(".chart[data-id=wind_direction] h3")


def test_the_page_could_not_reach_a_network_if_it_wanted_to(page):
    refused = page.tab.evaluate("() => fetch('https://example.org/').then(() => 'sent', (error) => String(error))")
    assert "TypeError" in refused
    assert (
        page.tab.evaluate("""() => {
        const script = document.createElement("script");
        script.textContent = "window.harmed = true";
        document.body.append(script);
        return window.harmed ?? "refused";
    }""")
        == "refused"
    )
    assert all("Content Security Policy" in text for text in page.complaints) and len(page.complaints) >= 2
    assert not [request for request in page.requests if request.startswith("http")]
    page.complaints.clear()


def test_the_slider_moves_the_time_and_the_maps(page, plant_run):
    before = [page.pixels(f".map[data-key={key}] canvas >> nth=0") for key in ("truth", "mean", "free")]
    assert "t = 0 of 100 s" in page.text("#now")
    page.go(8)
    assert "t = 40 of 100 s" in page.text("#now")
    after = [page.pixels(f".map[data-key={key}] canvas >> nth=0") for key in ("truth", "mean", "free")]
    assert min(differ(*pair) for pair in zip(before, after, strict=True)) > 0.01
    err = page.find(".chart[data-id=err] .legend b").all_inner_texts()
    assert number(err[0]) == pytest.approx(float(plant_run["err"][8]), rel=0.006)
    page.go(0)
    again = [page.pixels(f".map[data-key={key}] canvas >> nth=0") for key in ("truth", "mean", "free")]
    assert max(differ(*pair) for pair in zip(before, again, strict=True)) == 0.0


def test_a_map_does_not_depend_on_what_was_shown_before(page):
    canvases = [f".map[data-key={key}] canvas >> nth={layer}" for key in ("truth", "spread") for layer in (0, 1)]

    def shown():
        return [page.pixels(canvas) for canvas in canvases]

    for row in range(9):  # by small steps, each of which draws only what is new
        page.go(row)
    stepped = shown()
    assert differ(stepped[1], np.zeros_like(stepped[1])) > 0.05, "buildings, route and readings"
    for row in (20, 0, 8):
        page.go(row)
    jumped = shown()
    page.find("#theme").click()
    page.find("#theme").click()
    page.drawn()
    for one, other, tinted in zip(stepped, jumped, shown(), strict=True):
        assert differ(one, other) == differ(one, tinted) == 0.0


def test_what_is_told_is_up_to_date_as_soon_as_it_stops(page, plant_run):
    page.find("#speed").select_option("60")
    page.tab.evaluate("() => { const { player } = window.dafw; player.play(); player.told = Infinity; }")
    page.tab.wait_for_function("() => window.dafw.player.row >= 3")
    assert "t = 0 of 100 s" in page.text("#now"), "while it plays, texts change ten times a second, here never"
    page.tab.keyboard.press("Space")
    page.drawn()
    time = plant_run["time"].values[page.tab.evaluate("() => window.dafw.player.row")]
    assert f"t = {time:g} of 100 s" in page.text("#now")
    for label in (".map[data-key=mean] canvas >> nth=0", ".chart[data-id=err] canvas"):
        assert f"t = {time:g} s" in page.find(label).get_attribute("aria-label")


def test_a_map_has_the_colours_of_the_values(page, plant_run):
    row = 4
    page.go(row)
    shown = page.pixels(".map[data-key=truth] canvas >> nth=0")
    height, width = shown.shape[:2]
    mesh = triangulation(plant_run)
    x = mesh.x.min() + (np.arange(width) + 0.5) / width * np.ptp(mesh.x)
    y = mesh.y.max() - (np.arange(height) + 0.5) / height * np.ptp(mesh.y)
    expected = LinearTriInterpolator(mesh, plant_run["concentration_truth"].values[row])(*np.meshgrid(x, y))
    table = np.frombuffer(base64.b64decode(colour_maps()["magma light"]), dtype=np.uint8).reshape(256, 3) / 255.0
    level = np.clip(255.0 * expected.filled(0.0) / fields_of(plant_run)["top"], 0, 255).astype(int)
    inside = ~np.ma.getmaskarray(expected) & (shown[..., 3] > 0)
    assert inside.mean() > 0.6
    off = np.abs(shown[..., :3] - table[level]).max(axis=-1)[inside]
    assert np.quantile(off, 0.99) < 0.03 and np.unique(level[inside]).size > 100
    # Where the map is empty there is no triangle; pixels on an edge belong to one of its sides.
    assert (np.ma.getmaskarray(expected) != (shown[..., 3] == 0)).mean() < 0.01


def test_playing_goes_on_by_itself_and_stops(page):
    page.find("#speed").select_option("25")
    page.find("#play").click()
    assert page.find("#play").get_attribute("aria-label") == "Pause"
    expect(page.find("#now")).to_contain_text("t = 100 of 100 s")
    expect(page.find("#play")).to_have_attribute("aria-label", "Play")
    page.find("#play").click()
    expect(page.find("#now")).not_to_contain_text("t = 100 of 100 s")
    page.find("#play").click()
    page.drawn()
    stopped = page.text("#now")
    page.tab.wait_for_timeout(200)
    assert page.text("#now") == stopped


def test_keys_move_the_time(page):
    keys = [("ArrowRight", 5), ("Shift+ArrowRight", 55), ("ArrowLeft", 50), ("End", 100), ("Home", 0)]
    for key, time in keys:
        page.tab.keyboard.press(key)
        page.drawn()
        assert f"t = {time} of" in page.text("#now")
    page.tab.keyboard.press("Space")
    assert page.find("#play").get_attribute("aria-label") == "Pause"
    page.tab.keyboard.press("Space")
    assert page.find("#play").get_attribute("aria-label") == "Play"
    page.tab.keyboard.press("Home")
    page.find("#slider").focus()
    page.tab.keyboard.press("ArrowRight")
    page.drawn()
    assert "t = 5 of" in page.text("#now")


def test_keys_that_a_control_needs_are_its_own(page):
    page.find("#place-x").focus()
    for key in ("ArrowRight", "End", "Space"):
        page.tab.keyboard.press(key)
    page.find("#play").focus()
    page.tab.keyboard.press("Space")  # the button's own: it must not be undone by the page's
    assert page.find("#play").get_attribute("aria-label") == "Pause"


def test_a_click_shows_the_series_at_that_place(page, plant_run):
    row, (x, y) = 6, (430.0, 390.0)
    page.go(row)
    at_place(page, "mean", x, y, plant_run)
    chart = page.find(".chart[data-id=place]")
    labels = [text.split()[0] for text in chart.locator(".legend li").all_inner_texts()]
    assert labels == ["truth", "belief", "free", "±"]
    mesh = triangulation(plant_run)
    place = [float(page.find(f"#place-{axis}").input_value()) for axis in "xy"]
    assert place == pytest.approx([x, y], abs=2.7), "a pixel is 2.7 m wide"
    for label, stage in zip(chart.locator(".legend b").all_inner_texts(), ("truth", "mean", "free"), strict=True):
        values = plant_run[f"concentration_{stage}"].values[row]
        expected = float(LinearTriInterpolator(mesh, values)(*place))
        assert number(label) == pytest.approx(expected, rel=0.02, abs=1e-4)
    hall = np.column_stack([plant_run[f"obstacle_{axis}"].values[:4] for axis in "xy"]).mean(axis=0)
    at_place(page, "mean", *hall, plant_run)
    assert "in a building" in page.text("#place") and not chart.is_visible()
    page.find("#place-x").fill("430")
    page.find("#place-y").fill("390")
    page.find("#place-y").press("Enter")
    page.drawn()
    assert chart.is_visible() and "x = 430 m" in chart.inner_text()


def test_dragging_over_a_curve_moves_the_time(page):
    plot = page.find(".chart[data-id=err] .plot")
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    page.tab.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 40)
    page.tab.mouse.down()
    page.tab.mouse.move(box["x"] + box["width"] - 2, box["y"] + 40, steps=3)
    page.tab.mouse.up()
    page.drawn()
    assert "t = 100 of" in page.text("#now")


def test_the_decisions_and_the_ranks_are_told(page, plant_run):
    page.go(7)
    page.find(".chart[data-id=scores]").scroll_into_view_if_needed()
    page.drawn()
    scores = plant_run["policy_sector_score"].values[7, 0]
    bearing = (90.0 - (np.argmax(scores) + 0.5) * 45.0) % 360.0
    told = page.text(".chart[data-id=scores] .legend")
    assert number(told.split("best: ")[1].split(",")[0]) == pytest.approx(scores.max(), rel=0.01)
    assert abs(float(told.split("bearing ")[1].split("°")[0]) - bearing) <= 0.5
    ranks = plant_run["observation_rank"].values
    counted = np.isfinite(ranks[:8]).sum()
    assert page.text(".chart[data-id=ranks] .legend").startswith(f"{counted} of {np.isfinite(ranks).sum()} readings")


def test_the_theme_follows_the_system_until_it_is_switched(show, plant_run):
    page = show(plant_run, color_scheme="dark")
    ground = "() => getComputedStyle(document.body).backgroundColor"
    dark, pixels = page.tab.evaluate(ground), page.pixels(".map[data-key=truth] canvas >> nth=0")
    page.find("#theme").click()
    page.drawn()
    assert page.tab.evaluate(ground) != dark and page.find("#theme").inner_text() == "Dark"
    assert differ(pixels, page.pixels(".map[data-key=truth] canvas >> nth=0")) > 0.5
    page.find("#colours").select_option("cividis")
    page.drawn()
    assert page.complaints == []
    page.tab.context.close()


def test_no_text_of_a_run_is_executed(show, plant_run, tmp_path):
    harm = "<script>window.harmed = 1</script><img src=x onerror='window.harmed = 1'></script><!--{{SCRIPT}}"
    run = plant_run.assign_attrs(title=harm, name=harm, seed=1, parts=f'{{"{harm}": "{harm}"}}'.replace("'", ""))
    run["landmark_name"] = ("landmark", np.array([harm, "release"], object))
    run["concentration_mean"].attrs["units"] = harm
    folder = tmp_path / "harm"
    (folder / ".hydra").mkdir(parents=True)
    (folder / ".hydra" / "config.yaml").write_text(f"name: {harm}\n")
    (folder / ".hydra" / "overrides.yaml").write_text(f'- "name={harm}"\n')
    run.to_netcdf(folder / "run.nc")
    page = show(run)
    whole = open_page(page.tab.context.browser, write_report(folder))
    for one in (page, whole):
        one.go(3)
        assert one.tab.evaluate("() => window.harmed ?? null") is None
        assert one.text("#title") == harm and one.tab.title() == harm
        assert one.find("main img").count() == 0 and one.find("main script").count() == 0
        assert one.complaints == []
        one.tab.context.close()


def test_the_command_and_the_configuration_are_shown_as_they_are(browser, plant_run, tmp_path):
    (tmp_path / ".hydra").mkdir()
    (tmp_path / ".hydra" / "config.yaml").write_text("filter:\n  name: etkf  # <b>\n")
    (tmp_path / ".hydra" / "overrides.yaml").write_text("- seed=3\n- start=[[1, 2]]\n")
    plant_run.to_netcdf(tmp_path / "run.nc")
    page = open_page(browser, write_report(tmp_path))
    assert page.text("#command") == "dafw run seed=3 'start=[[1, 2]]'"
    page.find("summary").click()
    assert page.text("details pre") == "filter:\n  name: etkf  # <b>\n"
    assert "rounded to 16 bits" in page.text("#exactness")
    page.tab.context.close()


def test_a_run_without_a_truth_has_what_there_is(show, plant_run):
    page = show(without_truth(plant_run))
    assert [key.get_attribute("data-key") for key in page.find(".map").all()] == ["mean", "free", "spread"]
    assert page.find(".chart[data-id=err]").count() == 0 and page.find(".chart[data-id=wind_speed]").count() == 1
    page.go(5)
    assert page.complaints == []
    page.tab.context.close()


def test_a_run_without_places_has_curves_only(show, ring_run):
    page = show(ring_run)
    assert page.find("#maps").is_hidden() and page.find("#profile").is_visible()
    before = page.pixels("#profile canvas")
    page.tab.keyboard.press("End")
    page.drawn()
    assert differ(before, page.pixels("#profile canvas")) > 0.005 and "t = 3 of 3 s" in page.text("#now")
    assert page.find(".chart[data-id=err]").is_visible() and page.complaints == []
    page.tab.context.close()


def test_a_run_with_one_row_and_one_with_two_fields_open(show, plant_run):
    first = show(plant_run.isel(time=[0]))
    assert first.find("#controls").is_hidden() and first.find(".map").count() == 4 and first.complaints == []
    first.tab.context.close()
    ends = plant_run.copy(deep=True)
    for name in [name for name in ends.data_vars if ends[name].dims == ("time", "node")]:
        ends[name].values[1:-1] = np.nan
    page = show(ends)
    page.go(10)
    assert page.find(".map[data-key=truth] figcaption").inner_text().split() == ["Truth", "of", "t", "=", "0", "s"]
    pale = "(canvas) => getComputedStyle(canvas).opacity < 0.5"
    assert page.find(".map[data-key=truth] canvas >> nth=0").evaluate(pale)
    at_place(page, "mean", 430.0, 390.0, ends)
    assert "recorded at 2 of 21 times" in page.text(".chart[data-id=place] h3")
    page.go(20)
    assert not page.find(".map[data-key=truth] canvas >> nth=0").evaluate(pale)
    assert "2 of 21 times" in page.text("#exactness") and page.complaints == []
    page.tab.context.close()


def test_a_belief_that_was_revised_can_be_chosen(show, plant_run):
    run = plant_run.assign(
        concentration_smoothed_mean=plant_run["concentration_truth"],
        concentration_smoothed_spread=0.1 * plant_run["concentration_spread"],
        err_smoothed=0.0 * plant_run["err"],
    )
    page = show(run)
    page.go(4)
    belief, truth = (f".map[data-key={key}] canvas >> nth=0" for key in ("mean", "truth"))
    assert differ(page.pixels(belief), page.pixels(truth)) > 0.01
    page.find("#belief").select_option("later")
    page.drawn()
    assert differ(page.pixels(belief), page.pixels(truth)) < 0.002
    assert page.find(".map[data-key=mean] figcaption span").inner_text() == "ERR 0\u202f%"
    assert page.complaints == []
    page.tab.context.close()


def test_a_phone_shows_it_without_scrolling_sideways(show, plant_run):
    page = show(plant_run, **PHONE)
    assert page.overflow() == 0
    page.find(".map[data-key=mean] .layers").tap(position={"x": 60, "y": 60})
    page.drawn()
    assert page.find("#place").is_visible() and page.overflow() == 0
    boxes = [page.find(f".map[data-key={key}]").bounding_box() for key in ("truth", "mean")]
    assert boxes[0]["y"] == boxes[1]["y"], "side by side"
    page.tab.set_viewport_size({"width": 320, "height": 600})
    page.drawn()
    assert page.overflow() == 0 and page.complaints == []
    page.tab.context.close()


def test_everything_that_can_be_used_has_a_name(page):
    tree = page.find("body").aria_snapshot()
    for entry in ('slider "Time"', 'button "Play"', 'button "To the start"', 'combobox "Scale"', 'spinbutton "x'):
        assert entry in tree, entry
    nameless = page.tab.evaluate("""() => [...document.querySelectorAll("button, select, input, [role=img]")].filter(
        (one) => !one.getAttribute("aria-label") && !one.labels?.length && !one.textContent.trim()
    ).map((one) => one.outerHTML)""")
    assert nameless == []
    assert "ERR of the belief" in page.find("#slider").get_attribute("aria-valuetext")


def test_a_page_can_be_measured_and_photographed(browser, plant_folder, tmp_path):
    file = write_report(plant_folder)
    found = measured(browser, file, "phone", loads=1, frames=5)
    assert found.open > 0.0 and found.draw > 0.0 and found.processor > 0.0 and len(found.intervals) == 4
    picture(browser, file, tmp_path / "page.png")
    assert imread(tmp_path / "page.png").std() > 0.05
