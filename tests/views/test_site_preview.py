"""A study on a site before it is run: what is said and drawn of it, places on free ground, the command, the page."""

from __future__ import annotations

import http.client
import json
import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from threading import Thread
from urllib.parse import quote

import numpy as np
import pytest
import shapely
from browser import differ, open_page
from playwright.sync_api import expect
from served import ask, served
from waiting import PATIENCE, until

from dafw.commands import main
from dafw.core.composition import compose, study_part
from dafw.core.experiment import study_from
from dafw.core.geography import metres_per_degree
from dafw.plugins.models.dispersion.reduced_wind.expected import MEASURED, seconds_of_basis
from dafw.plugins.models.dispersion.wind.options import BasisOptions
from dafw.studies.stopping import stop_signals
from dafw.views.site_page import page_of_site
from dafw.views.site_picture import plot_site
from dafw.views.site_places import Places
from dafw.views.site_preview import preview_of
from dafw.views.site_server import SiteServer, serve

COARSE = ["model.mesh.wall_size=60", "model.mesh.far_size=90", "model.mesh.across=1"]
PHONE = {"viewport": {"width": 390, "height": 844}, "device_scale_factor": 2, "is_mobile": True, "has_touch": True}
CENTRE = np.array([8.0, 50.0])
HALL = "hall <b>'7'</b>"


def ring(*corners):
    degrees = CENTRE + np.array(corners, dtype=float) / metres_per_degree(CENTRE[1])
    return [*degrees.tolist(), degrees[0].tolist()]


def box(x_min, y_min, x_max, y_max):
    return ring((x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max))


def feature(*rings, **tags):
    geometry = {"type": "Polygon", "coordinates": list(rings)}
    return {"type": "Feature", "properties": {"building": "yes", **tags}, "geometry": geometry}


FEATURES = [
    feature(box(-150, -100, -50, 0), box(-120, -70, -80, -30), name=HALL),
    feature(box(50, -100, 98, 0)),
    feature(box(100, -100, 150, 0)),
    feature(ring((0, 50), (60, 100), (60, 50), (0, 100)), name="bow tie"),
    feature(box(0, 20, 2, 22), name="hut"),
]
"""A hall with a yard, two halls 2 m apart, one that crosses itself, and a hut that is too small."""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Return the path of a site of 460 m x 360 m about the origin, whose name no shell takes as it is."""
    path = tmp_path_factory.mktemp("site") / "my 'own' $site.geojson"
    whole = {"type": "FeatureCollection", "attribution": "(c) somebody", "features": FEATURES}
    path.write_text(json.dumps(whole))
    return path


@pytest.fixture(scope="module")
def variables(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DAFW_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def preview(file, variables):
    return preview_of(str(file), COARSE)


def composed(command):
    """Return what ``dafw run`` makes of a command after a shell has read it."""
    words = shlex.split(command)
    assert words[:2] == ["dafw", "run"]
    return study_part(compose(words[2:]))


# --- places and the command -----------------------------------------------------------------------------------------


def test_places_in_buildings_and_outside_are_moved_to_free_ground(preview):
    ground = preview.ground
    assert ground.problem((-70.0, -50.0)) == f"is in {HALL!r}"
    assert ground.problem((-100.0, -50.0)) == f"is in {HALL!r}", "the yard is filled"
    assert ground.problem((0.0, -50.0)) == "" and ground.clearance((0.0, -50.0)) == pytest.approx(50.0, abs=0.1)
    assert ground.problem((231.0, 0.0)) == "is outside of the site"
    assert ground.free_near((0.0, -50.0), 30.0) == (0.0, -50.0)
    for place, clearance in (((-70.0, -50.0), 30.0), ((300.0, 72.0), 30.0), ((-70.0, -50.0), 1000.0)):
        moved = ground.free_near(place, clearance)
        assert ground.problem(moved) == "" and shapely.box(*preview.site.bounds).covers(shapely.Point(moved))
        if clearance < 1000.0:
            assert ground.clearance(moved) > clearance - 0.1
    assert ground.free_near((-70.0, -50.0), 30.0)[0] == pytest.approx(-20.0, abs=0.2), "the nearest one"


def test_the_command_is_what_dafw_run_takes(preview, file):
    command = preview.command(Places((-10.04, 0.0), ((20.0, -30.26),)))
    found = composed(command)
    assert found["model"]["site"]["file"] == str(file)
    assert found["model"]["release"] == [-10.0, 0.0] and found["vehicle"]["start"] == [[20.0, -30.3]]
    assert found["section"] == [] and found["model"]["mesh"]["wall_size"] == 60.0
    assert "-0.0" not in preview.command(Places((-0.01, -0.04), ((0.0, 1.0),)))


def test_the_places_that_are_suggested_are_accepted(preview):
    assert preview.ground.problem(preview.places.release) == "is outside of the site", "the default's are the plant's"
    study_from(composed(preview.command(preview.free_places))).prepare()


def test_a_study_with_a_truth_of_its_own_place_and_a_prior_moves_all_of_them(file, variables):
    words = ["experiment=leak", "model.release=[1,2]", "section=[[0,0],[1,1]]", *COARSE]
    preview = preview_of(str(file), words)
    assert preview.places.release == (258.0, 72.0), "that of the truth"
    command = preview.command(Places((0.0, -20.0), ((0.0, 0.0), (5.0, 5.0))))
    found = composed(command)
    assert found["model"]["release"] == found["truth"]["release"] == [0.0, -20.0]
    assert [found["model"]["priors"][f"release_{axis}"]["mean"] for axis in "xy"] == [0.0, -20.0]
    assert found["vehicle"]["start"] == [[0.0, 0.0], [5.0, 5.0]]
    assert found["section"] == [[0, 0], [1, 1]] and "model.release=[1,2]" not in command


def test_the_plant_keeps_its_section(variables):
    assert "section" not in preview_of("plant", COARSE).command(Places((258.0, 72.0)))


# --- what is said and drawn -----------------------------------------------------------------------------------------


def test_what_was_changed_has_exact_areas(preview):
    changes = preview.changes
    yard, gap = 40.0 * 40.0, 2.0 * 100.0
    bow = changes.added.intersection(shapely.box(0, 50, 60, 100)).area
    assert changes.added.area - bow == pytest.approx(yard + gap, rel=0.01) and 0.0 < bow < 30.0
    assert changes.removed.area == pytest.approx(4.0, rel=0.05) and changes.outside.is_empty
    assert len(changes.crossing) == 1 and changes.crossing[0].centroid.x == pytest.approx(30.0, abs=1.0)


def test_the_numbers_are_those_of_the_mesh(preview):
    nodes, triangles = preview.mesh
    lines = preview.size_lines()
    assert lines[0] == f"mesh of {len(nodes):,} nodes, {len(triangles):,} triangles"
    assert lines[1] == "memory: about 0.5 GB, with 10 members" and "the first run makes the winds" in lines[2]
    study, *_ = preview.study.models.values()
    assert len(nodes) == study.space["concentration"].size


def test_the_time_of_a_basis_is_what_was_measured():
    usual = BasisOptions()
    assert [seconds_of_basis(nodes, usual) for nodes, _ in MEASURED] == pytest.approx([time for _, time in MEASURED])
    times = [seconds_of_basis(nodes, usual) for nodes in (1, 300, 5_000, 20_000, 200_000)]
    assert times == sorted(times) and times[0] > 0.0
    assert seconds_of_basis(2_715, BasisOptions(directions=16, modes=80)) == pytest.approx(39.0 / 2)


def test_the_picture_has_the_site_and_marks_what_is_not_free(preview):
    figure = plot_site(preview)
    (axes,) = figure.axes
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "filled: holes, yards, gaps" in labels and "repaired: crossed itself" in labels
    assert "left out: rim, too small, too thin" in labels and "drone's start" in labels
    assert "not free: dafw run would refuse" in labels and "wind, truth: 5 m/s" in labels
    assert "wind, first guess: 2.5 m/s" in labels
    assert "(c) somebody" in [text.get_text() for text in axes.texts]
    assert axes.get_title().endswith("4 buildings") or axes.get_title().endswith("3 buildings")
    x_min, x_max = axes.get_xlim()
    assert x_min < preview.site.bounds[0] and x_max > preview.site.bounds[2]


def test_the_command_line_draws_and_suggests(preview, file, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["site", "preview", str(file), *COARSE, "vehicle.start=[[-70,-50]]"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert f"drone at (-70, -50) m is in {HALL!r}: dafw run would refuse it" in lines
    assert "release at (258, 72) m is outside of the site: dafw run would refuse it" in lines
    assert sum(line.startswith("  free ground near it: ") for line in lines) == 2
    picture = Path(lines[-2])
    assert picture.read_bytes()[:4] == b"\x89PNG" and picture.name == "my 'own' $site_preview.png"
    assert composed(lines[-1])["vehicle"]["start"] != [[-70, -50]]


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ([], "the following arguments are required: FILE"),
        (["nowhere.geojson"], "site file nowhere.geojson: not found"),
        (["plant", "model.site.file=x"], "it cannot be an option, too"),
        (["plant", "experiment=lorenz96"], "model 'lorenz96' has no site"),
        (["plant", "model.site.marginn=3"], "marginn"),
        (["plant", "model.mesh.wall_size=1,2"], "1,2"),
        (["plant", "-o", "x.jpg"], "a picture's name that ends in .png"),
        (["plant", "--serve", "--port", "70000"], "port 70000 cannot be used"),
        (["plant", "--port", "x"], "invalid int value"),
    ],
)
def test_wrong_requests_are_one_line(words, problem, variables, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["site", "preview", *words, *(COARSE if words and "lorenz" not in words[-1] else [])]) == 2
    error = capsys.readouterr().err
    assert problem in error and error.startswith("dafw: ") and error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_word_that_is_no_command_is_refused(capsys):
    assert main(["site"]) == 2 and main(["site", "fech"]) == 2
    assert capsys.readouterr().err.splitlines()[1] == "dafw: site: expected fetch or preview, got fech"


# --- the page -------------------------------------------------------------------------------------------------------


def test_the_server_answers_with_the_command_or_says_why_not(preview):
    with served(SiteServer(preview)) as server:
        first = server.chosen
        assert composed(first)["model"]["release"] == list(preview.free_places.release)
        status, text = ask(server, "/command?at=0,-20&at=10,-40")
        assert status == 200 and json.loads(text)["command"] == server.chosen != first
        assert composed(server.chosen)["vehicle"]["start"] == [[10.0, -40.0]]
        assert len(json.loads(text)["about"]) == 2
        chosen = server.chosen
        problem = json.loads(ask(server, "/command?at=0,-20&at=-70,-50")[1])
        assert set(problem) == {"problem"} and "the drone stays where it was" in problem["problem"]
        for wrong in ("", "at=1,2", "at=1,2&at=3", "at=1,2&at=nan,0", "at=1,2&at=1e99,0", f"at={quote('x,y')}&at=1,2"):
            assert ask(server, f"/command?{wrong}")[0] == 400
        assert ask(server, "/command?at=0,-20&at=10,-20", Sec_Fetch_Site="cross-site")[0] == 200
        assert server.chosen == chosen, "what another site's page asks for is not the user's choice"
        assert ask(server, "/", Host="elsewhere.example")[0] == 403
        assert ask(server, "/site.geojson")[0] == 404


def test_the_page_has_no_mesh_that_would_cover_everything(preview, monkeypatch):
    monkeypatch.setattr("dafw.views.site_page.MOST_NODES", 10)
    assert page_of_site(preview)["map"]["triangles"] == ""


def test_an_interrupt_prints_the_last_command_and_closes_the_port(preview, monkeypatch, capsys):
    def interrupted(server):
        ask_later = Thread(target=ask, args=(server, "/command?at=0,-20&at=10,-40"))
        ask_later.start()
        server.handle_request()
        ask_later.join()
        ignored = re.search(r"SigIgn:\s*([0-9a-f]+)", Path("/proc/self/status").read_text())[1]
        assert int(ignored, 16) >> (signal.SIGPIPE - 1) & 1, "a browser that hangs up must not end the server"
        raise KeyboardInterrupt

    monkeypatch.setattr(SiteServer, "serve_forever", interrupted)
    serve(SiteServer(preview))
    address, command = capsys.readouterr().out.splitlines()
    assert composed(command)["model"]["release"] == [0.0, -20.0]
    with pytest.raises(OSError):
        http.client.HTTPConnection(address.split("/")[2], timeout=PATIENCE).request("GET", "/")


def test_a_signal_ends_the_command(file, tmp_path):
    words = [sys.executable, "-m", "dafw", "site", "preview", str(file), "--serve", *COARSE]
    told = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "cwd": tmp_path}
    with subprocess.Popen(words, **told, env={**os.environ, "DAFW_CACHE": str(tmp_path)}) as serving:
        try:
            assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\n", serving.stdout.readline())
            serving.send_signal(signal.SIGTERM)  # the mesh is read with PETSc, which sets signals to end a process
            out, err = serving.communicate(timeout=PATIENCE)
        finally:
            serving.kill()
    assert (serving.returncode, err) == (0, "") and composed(out)["section"] == []


def test_whoever_reads_the_address_may_end_the_command_at_once(preview, monkeypatch):
    signals = {number: signal.getsignal(number) for number in (signal.SIGPIPE, signal.SIGTERM)}
    lines = []

    def say(line, flush):
        lines.append(line)
        if len(lines) == 1:
            os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr("dafw.views.site_server.print", say, raising=False)
    try:
        server = SiteServer(preview)
        with stop_signals():
            serve(server)
    finally:
        signal.signal(signal.SIGPIPE, signals[signal.SIGPIPE])
    assert lines == [server.address, server.chosen]
    assert signal.getsignal(signal.SIGTERM) == signals[signal.SIGTERM]


def clicked(page, preview, x, y):
    """Click a place (m) on the map."""
    x_min, y_min, x_max, y_max = preview.site.bounds
    frame = page.find("#map").bounding_box()
    right, down = (x - x_min) / (x_max - x_min), (y_max - y) / (y_max - y_min)
    page.tab.mouse.click(frame["x"] + right * frame["width"], frame["y"] + down * frame["height"])


def test_release_and_drone_are_placed_in_a_browser(browser, preview):
    with served(SiteServer(preview)) as server:
        page = open_page(browser, server.address)
        before = page.pixels("#over")
        clicked(page, preview, 0.0, -60.0)
        expect(page.find("#places p").first).to_contain_text("from the nearest wall")
        expect(page.find("#command")).not_to_have_text(preview.command(preview.free_places))
        page.drawn()
        assert differ(before, page.pixels("#over")) > 0.001
        assert np.allclose(composed(page.text("#command"))["model"]["release"], [0.0, -60.0], atol=2.0)
        placed = page.text("#command")

        page.find("input[name=spot]").nth(1).check()
        clicked(page, preview, -100.0, -50.0)  # the yard of the hall, which is filled
        expect(page.find("#refused")).to_contain_text(f"is in {HALL!r}: the drone stays where it was")
        assert page.text("#command") == placed and page.find("#map b").count() == 0

        page.find("#map").focus()
        start = composed(placed)["vehicle"]["start"][0]
        for key in ("ArrowRight", "ArrowRight", "Shift+ArrowUp"):  # quicker than the server answers
            page.tab.keyboard.press(key)
        expect(page.find("#refused")).to_be_hidden()
        moved = [start[0] + 2.0, start[1] + 10.0]
        expect(page.find("#places input[type=number]").nth(2)).to_have_value(f"{moved[0]:g}")

        def has_moved():
            return composed(page.text("#command"))["vehicle"]["start"] == [pytest.approx(moved)]

        until(has_moved, "the command with the drone where the keys have moved it")
        page.find("#places input[type=number]").nth(2).fill("-70")
        page.find("#places input[type=number]").nth(3).fill("-50")
        page.find("#places input[type=number]").nth(3).press("Enter")
        expect(page.find("#refused")).to_contain_text("is in")
        # Each of the two numbers is asked about, and the first answer may be there before the second.
        expect(page.find("#places input[type=number]").nth(3)).to_have_value(f"{moved[1]:g}")

        light = page.pixels("#walls")
        page.find("#theme").click()
        page.drawn()
        assert differ(light, page.pixels("#walls")) > 0.05
        assert page.find("#attribution").inner_text() == "(c) somebody"
        assert (
            page.find("button, input, [tabindex='0']").evaluate_all(
                "(all) => all.filter((one) => !(one.labels?.length || one.ariaLabel || one.textContent.trim())).length"
            )
            == 0
        )
        small = open_page(browser, server.address, color_scheme="dark", **PHONE)
        assert small.overflow() == 0
        for one in (page, small):
            assert one.complaints == [] and all(
                request.startswith((server.address, "data:")) for request in one.requests
            )
            one.tab.context.close()
