"""Buildings from an Overpass server: exact shapes, one clear line for each way to fail, nothing half-written."""

from __future__ import annotations

import json
import os
import socket
from datetime import UTC, datetime, timedelta
from email.utils import format_datetime

import numpy as np
import pytest
import shapely
from overpass import (
    answer_of,
    babble,
    busy,
    cut_off,
    drip,
    endless,
    hang_up,
    relation,
    sends,
    silence,
    standing_in,
    way,
)

from dafw.commands import main
from dafw.core.errors import ConfigurationError, FetchError, SiteError
from dafw.core.geography import metres_per_degree
from dafw.plugins.models.dispersion.site import fetch as fetching
from dafw.plugins.models.dispersion.site import overpass
from dafw.plugins.models.dispersion.site.area import area_around, area_between
from dafw.plugins.models.dispersion.site.fetch import ATTRIBUTION, attribution_of, fetch
from dafw.plugins.models.dispersion.site.options import SiteOptions
from dafw.plugins.models.dispersion.site.site import load_site

CENTRE = np.array([8.425, 49.505])
SCALE = np.array(metres_per_degree(CENTRE[1]))
AREA = area_around("49.505,8.425,200")


def at(*metres):
    """Return places in degrees, with the digits of OpenStreetMap."""
    return np.round(CENTRE + np.array(metres, dtype=float) / SCALE, 7).tolist()


def rectangle(x_min, y_min, x_max, y_max):
    return at((x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max))


def closed(ring):
    return [*ring, ring[0]]


HALL = way(3, rectangle(-60, -60, 60, 60), building="industrial", name="hall", roof="flat")


@pytest.fixture
def server(monkeypatch, tmp_path):
    monkeypatch.setenv("DAFW_CACHE", str(tmp_path / "cache"))
    with standing_in() as server:
        monkeypatch.setenv("DAFW_OVERPASS", server.address)
        yield server


@pytest.fixture
def ask(server, tmp_path):
    """Return a function that fetches after some tricks; it returns the file, what was said, and the pauses."""

    def fetched(*tricks, area=AREA, timeout=20.0, cache=tmp_path / "cache", **more):
        server.tricks[:] = tricks
        file, said, pauses = tmp_path / "site.geojson", [], []
        told = {"say": said.append, "sleep": pauses.append}
        found = fetch(area, file, server.address, timeout, cache=cache, **told, **more)
        return found, file, said, pauses

    return fetched


def shapes(file):
    """Return the geometries (in m about the centre) and properties of a file by the names of its features."""
    document = json.loads(file.read_text())

    def metres(points):
        return (points - CENTRE) * SCALE

    return {
        feature["id"]: (
            shapely.transform(shapely.geometry.shape(feature["geometry"]), metres),
            feature["properties"],
        )
        for feature in document["features"]
    }


# --- what is written ------------------------------------------------------------------------------------------------


def test_ways_and_multipolygons_become_buildings_that_a_site_reads(ask):
    outer = closed(rectangle(-160, 80, -80, 180))
    court = relation(
        9,
        # two halves of the outer ring, one of them backwards; a yard; a building in the yard
        [
            ("outer", outer[:3]),
            ("outer", outer[2:][::-1]),
            ("inner", closed(rectangle(-140, 100, -100, 160))),
            ("outer", closed(rectangle(-130, 120, -110, 140))),
            ("part", rectangle(0, 0, 9, 9)),
        ],
        building="yes",
    )
    found, file, said, pauses = ask(sends(answer_of([court, HALL])))
    assert list(shapes(file)) == ["way/3", "relation/9"] and said == pauses == []
    hall, tags = shapes(file)["way/3"]
    assert hall.area == pytest.approx(120 * 120, rel=1e-3)
    assert tags == {"building": "industrial", "name": "hall"}
    yard, _ = shapes(file)["relation/9"]
    assert yard.area == pytest.approx(80 * 100 - 40 * 60 + 20 * 20, rel=1e-3)
    assert [len(part.interiors) for part in yard.geoms] == [1, 0]
    for shape in (hall, *yard.geoms):  # RFC 7946
        assert shape.exterior.is_ccw and not any(hole.is_ccw for hole in shape.interiors)
    site = load_site(SiteOptions(file=str(file)))
    assert site.names == ("hall", "building 2") and site.types == ("industrial", "building")
    assert found.date == "2026-11-29T12:00:00Z" and found.incomplete == 0 and not found.left_out
    assert attribution_of(file) == ATTRIBUTION
    assert ATTRIBUTION.startswith("(c) OpenStreetMap contributors, ODbL")


def test_what_is_broken_is_left_out_and_counted(ask):
    bow_tie = way(4, at((70, 70), (110, 110), (110, 70), (70, 110)), building="yes")
    broken = [
        way(5, rectangle(0, 80, 20, 90), closed=False, building="yes"),
        way(6, [], closed=False, building="yes"),
        {**way(7, rectangle(0, 80, 20, 90)), "geometry": [None, {"lat": 49.505, "lon": 8.425}]},
        {**way(8, rectangle(0, 80, 20, 90)), "geometry": [{"lat": "north", "lon": 8}] * 4},
        {**way(9, rectangle(0, 80, 20, 90)), "geometry": [{"lat": 490.0, "lon": 8.0}] * 4},
        {"type": "way", "id": 10},
        relation(11, [("outer", rectangle(0, 80, 20, 90))], building="yes"),
        {"type": "relation", "id": 12, "members": "none"},
        way(13, rectangle(9000, 0, 9020, 20), building="yes"),
        {"type": "node", "id": 14, "lat": 49.5, "lon": 8.4},
        {"type": "way", "id": "15"},
        "a building",
        HALL,
    ]
    parts = [("outer", closed(rectangle(-150, 80, -120, 110))), ("inner", rectangle(-140, 90, -130, 100))]
    half = relation(16, parts, building="yes")
    found, file, *_ = ask(sends(answer_of([HALL, bow_tie, half, *broken])))
    assert list(shapes(file)) == ["way/3", "way/4", "relation/16"]
    assert sorted(found.left_out.values()) == [1, 3, 4, 4] and found.incomplete == 1
    site = load_site(SiteOptions(file=str(file)))
    assert len(site.buildings) == 3 and site.report["repaired"] == 1


def test_names_that_no_file_can_hold_are_mended(ask):
    _, file, *_ = ask(sends(answer_of([way(1, rectangle(0, 0, 50, 50), building="yes", name="half \ud800, 'ü'\n")])))
    assert shapes(file)["way/1"][1]["name"] == "half ?, 'ü'\n"


def test_the_query_asks_for_the_area_and_for_what_a_site_takes_for_a_building(ask, server):
    ask(area=area_between("8.42,49.5,8.43,49.51"), timeout=33.0)
    ((query, headers),) = server.asked
    assert "(49.5,8.42,49.51,8.43)" in query and "[timeout:33]" in query and query.endswith("out geom;")
    assert '["building"]["building"!="no"]' in query and "storage_tank" in query
    assert headers["User-Agent"].startswith("dafw/")


# --- servers that misbehave -----------------------------------------------------------------------------------------


def test_a_busy_server_is_asked_again_after_longer_pauses_or_when_it_says(ask, server):
    soon = format_datetime(datetime.now(UTC) + timedelta(seconds=100))
    good = answer_of([HALL])
    found, _, said, pauses = ask(busy(429), busy(503, Retry_After="7"), busy(504, Retry_After=soon), sends(good))
    assert len(found.features) == 1 and len(server.asked) == 4
    assert pauses[:2] == [5.0, 7.0] and 1.0 <= pauses[2] <= 100.0
    assert "status 429" in said[0] and "too busy to handle your request" in said[0] and "again in 5 s" in said[0]


@pytest.mark.parametrize("trick", [hang_up, cut_off(answer_of([HALL]), 10_000)])
def test_an_answer_that_breaks_off_is_asked_for_again(ask, trick):
    found, _, said, pauses = ask(trick, sends(answer_of([HALL])))
    assert len(found.features) == 1 and len(said) == len(pauses) == 1


@pytest.mark.parametrize(
    ("trick", "tries", "problem"),
    [
        (busy(429), 4, "status 429 .*asked 4 times, try again later"),
        (busy(500, Retry_After="soon"), 4, "status 500"),
        (busy(429, Retry_After="4000"), 1, "asks to come back in 4000 s"),
        (busy(400), 1, r"status 400 .*is this the address of an Overpass server\?"),
        (sends(b"", 404), 1, "status 404"),
        (sends(b"cut", 403, Content_Length="99"), 1, "status 403"),
        (sends(b""), 1, "expected JSON, got nothing"),
        (
            sends(b"<html><head><title>x</title></head><b>Log in &amp; pay</b>", 200),
            1,
            "a page that says: Log in & pay",
        ),
        (sends(answer_of([HALL])[:-30]), 1, "no JSON, or was cut off after"),
        (sends(b"[" * 100_000), 1, "no JSON"),
        (sends(b'{"elements": 3}'), 1, "with a list 'elements'"),
        (sends(b"[]"), 1, "with a list 'elements'"),
        (sends(b'{"elements": [], "remark": "runtime error: out of memory"}'), 1, "gave up .*out of memory"),
        (sends(answer_of([])), 1, "no building between longitude"),
        (sends(answer_of([way(1, rectangle(0, 0, 9, 9), closed=False)])), 1, "left out: 1 without a closed outline"),
        (babble, 1, "does not answer as a web server does"),
        (hang_up, 4, "closed the connection"),
    ],
)
def test_every_failure_is_one_line_and_writes_nothing(ask, server, tmp_path, trick, tries, problem):
    with pytest.raises((ConfigurationError, FetchError, SiteError), match=problem) as caught:
        ask(*[trick] * 4)
    assert len(server.asked) == tries and "\n" not in str(caught.value)
    assert [path for path in tmp_path.rglob("*") if path.suffix in (".geojson", ".part")] == []


@pytest.mark.parametrize("trick", [silence, drip])
def test_a_server_that_takes_too_long_is_given_up(ask, server, trick):
    with pytest.raises(FetchError, match=r"no answer in|takes too long"):
        ask(*[trick] * 4, timeout=0.1)
    assert len(server.asked) == 4


def test_an_answer_without_an_end_is_refused(ask, monkeypatch):
    monkeypatch.setattr(overpass, "LARGEST", 2**20)
    with pytest.raises(FetchError, match=r"larger than 1 MB; ask for a smaller area"):
        ask(endless)


def test_a_server_that_is_not_there_is_not_asked_again(tmp_path):
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = f"http://127.0.0.1:{unused.getsockname()[1]}/api"
        with pytest.raises(FetchError, match=r"cannot be reached \(Connection refused\)"):
            fetch(AREA, tmp_path / "site.geojson", address, 5.0, cache=tmp_path, say=pytest.fail, sleep=pytest.fail)


# --- the cache ------------------------------------------------------------------------------------------------------


def test_an_answer_is_kept_for_a_week(ask, server, tmp_path):
    good = sends(answer_of([HALL]))
    _, file, *_ = ask(good)
    first = file.read_bytes()
    _, _, said, _ = ask(timeout=50.0)  # would get the plant
    assert len(server.asked) == 1 and file.read_bytes() == first and "--anew asks again" in said[0]
    ask(good, anew=True)
    assert len(server.asked) == 2
    ask(good, area=area_around("49.505,8.425,201"))
    assert len(server.asked) == 3
    (kept, other) = sorted((tmp_path / "cache").glob("overpass-*.json"), key=lambda path: path.stat().st_mtime)
    kept.write_bytes(kept.read_bytes()[:100])
    ask(good)
    assert len(server.asked) == 4, "a damaged answer is asked for again"
    old = kept.stat().st_mtime - fetching.OLD - 10.0
    for path in (kept, other):
        os.utime(path, (old, old))
    ask(good)
    assert len(server.asked) == 5 and not other.exists()


def test_a_wrong_answer_is_not_kept(ask, server):
    with pytest.raises(FetchError):
        ask(sends(b"{"))
    assert len(ask(sends(answer_of([HALL])))[0].features) == 1 and len(server.asked) == 2


def test_without_a_cache_it_goes_on_and_says_so(ask, tmp_path):
    (tmp_path / "file").touch()
    found, _, said, _ = ask(sends(answer_of([HALL])), cache=tmp_path / "file")
    assert len(found.features) == 1 and "cannot be kept" in said[0]


# --- the command ----------------------------------------------------------------------------------------------------


def test_the_command_says_what_it_wrote_and_what_comes_next(server, tmp_path, capsys):
    server.tricks.append(sends(answer_of([HALL, way(5, rectangle(0, 80, 20, 90), closed=False)])))
    file = tmp_path / "my site.geojson"
    assert main(["site", "fetch", "--bbox", "8.42,49.5,8.43,49.51", "-o", str(file)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{file}: 1 building, data of 2026-11-29T12:00:00Z"
    assert lines[1:] == ["1 left out: without a closed outline", ATTRIBUTION, f"next: dafw site preview '{file}'"]
    before = file.read_bytes()
    assert main(["site", "fetch", "--around", "49.505,8.425,200", "-o", str(file)]) == 2
    assert "exists already; nothing was changed" in capsys.readouterr().err and file.read_bytes() == before
    assert main(["site", "fetch", "--around", "49.505,8.425,300", "-o", str(file), "--force"]) == 0
    assert len(json.loads(file.read_text())["features"]) > 10


def test_a_server_in_the_west_and_one_that_fails(server, tmp_path, capsys):
    words = ["site", "fetch", "--bbox", "-122.31,37.8,-122.3,37.81", "-o", str(tmp_path / "west.geojson")]
    server.tricks.append(sends(b"{}"))
    assert main(words) == 1
    assert capsys.readouterr().err.startswith(f"dafw: {server.address}: expected the answer of an Overpass server")
    assert main(words) == 0
    assert load_site(SiteOptions(file=words[-1])).origin[0] == pytest.approx(-122.305, abs=0.01)


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ([], "one of the arguments --bbox --around is required"),
        (["--bbox", "1,2,3"], "--bbox expects W,S,E,N as numbers"),
        (["--bbox", "8,49,x,50"], "--bbox expects W,S,E,N as numbers"),
        (["--bbox", "8.1,49,8,49.1"], "with W < E"),
        (["--bbox", "8,nan,9,50"], "as numbers"),
        (["--bbox", "8,49,9,50"], "expected sides of at most 20 km"),
        (["--around", "49,8,0"], "a radius above 0"),
        (["--around", "100,8,50"], "a latitude within"),
        (["--around", "49,179.9999,500"], "crosses the date line"),
        (["--around", "49,8,20000"], "expected sides of at most 20 km"),
        (["--around", "49,8,50", "--bbox", "1,2,3,4"], "not allowed with"),
        (["--around", "49,8,50", "--server", "file:///etc/passwd"], "expected the address of a server"),
        (["--around", "49,8,50", "--server", "http://a b/"], "expected the address of a server"),
        (["--around", "49,8,50", "--server", "http://me:secret@host/"], "expected the address of a server"),
        (["--around", "49,8,50", "--timeout", "0"], "expected a --timeout between"),
        (["--around", "49,8,50", "--timeout", "nan"], "expected a --timeout between"),
        (["--around", "49,8,50", "-o", "nowhere/site.geojson"], "in a folder that exists"),
    ],
)
def test_wrong_requests_are_refused_before_anybody_is_asked(server, tmp_path, monkeypatch, capsys, words, problem):
    monkeypatch.chdir(tmp_path)
    assert main(["site", "fetch", *words]) == 2
    error = capsys.readouterr().err
    assert problem in error and error.startswith("dafw: ") and error.count("\n") == 1
    assert server.asked == []


def test_a_square_around_a_place_has_the_sides_that_were_asked_for():
    from pyproj import Geod

    area = area_around("60,-30.5,400")
    ellipsoid = Geod(ellps="WGS84")
    assert ellipsoid.line_length([area.west, area.east], [60, 60]) == pytest.approx(800, rel=1e-4)
    assert ellipsoid.line_length([-30.5, -30.5], [area.south, area.north]) == pytest.approx(800, rel=1e-4)
