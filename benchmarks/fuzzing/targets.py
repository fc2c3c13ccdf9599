"""What reads broken input: files of readings, of buildings, feeds, journals, inboxes and checkpoints.

Each function is given a folder of its own and a generator. It returns how the input was taken: "read", or the first
words of the error in one line with which it was refused. Whatever else it raises is a finding.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from benchmarks.fuzzing.spoiling import dataset, spoiled, spoiled_json
from dafw import Domain, Request, StateSpace, Variable
from dafw.core.errors import ContractError, DafwError, NoMoreReadingsError
from dafw.core.observation import nothing
from dafw.plugins.readings.feed.inbox import FILE as INBOX
from dafw.plugins.readings.feed.inbox import Inbox
from dafw.plugins.readings.feed.journal import FILE
from dafw.plugins.readings.live import Live
from dafw.plugins.readings.recorded import Recorded

NODES = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 100.0]])
TRIANGLES = np.array([[0, 1, 3], [0, 3, 2]], dtype=np.int32)
SPACE = StateSpace([Variable("gas", 4, units="mg m-3", coordinates=NODES, plausible=1e4)])
WALL = np.array([[40.0, 40.0], [60.0, 40.0], [60.0, 60.0], [40.0, 60.0]])
GROUND = Domain((0.0, 0.0, 100.0, 100.0), (WALL,), ("shed",), TRIANGLES, origin=(8.0, 50.0))
CYCLES = 8
LONGEST = 1000
"""Characters that an error may have."""

CSV = b"""time,x,y,value,unit,sd,sensor,arrives
1,10,20,5,mg m-3,0.1,a,1
2,11,20,0.006,g m-3,0.001,a,2.5
2.5,,,7,mg m-3,0.1,b,
"""
DATED = b"""when;longitude;latitude;value (mg m-3);sensor
2026-11-30T12:00:00Z;8,0001;50,0001;5,5;a
2026-11-30T13:00:01+01:00;8,0002;50,0002;6,5;b
"""
POINTS: Any = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [8.0001, 50.0001]},
            "properties": {"time": time, "value": 2.0, "sd": 0.5, "unit": "mg m-3", "sensor": "a"},
        }
        for time in (1, 2, 2.5)
    ],
}
BUILDINGS: Any = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "geometry": {"type": kind, "coordinates": place},
            "properties": {"building": "yes", "name": "hall"},
        }
        for kind, place in (
            ("Polygon", [[[8.0, 50.0], [8.001, 50.0], [8.001, 50.0005], [8.0, 50.0005], [8.0, 50.0]]]),
            ("MultiPolygon", [[[[8.002, 50.0], [8.003, 50.0], [8.003, 50.0005], [8.002, 50.0]]]]),
        )
    ],
}
MESSAGES: list[Any] = [
    {"time": 0.5, "x": 10, "y": 20, "value": 3.0, "sd": 0.5, "sensor": "drone 0"},
    {"time": 1.0, "lon": 8.0001, "lat": 50.0001, "value": 0.003, "sd": 0.001, "unit": "g m-3", "sensor": "a"},
    {"until": 1.0},
    {"time": 1.5, "entry": 3, "value": 1.0, "sd": 0.5},
    {"time": 0.7, "x": 70, "y": 20, "value": 2.0, "sd": 0.5},
    {"time": 2.5, "x": 12, "y": 22, "sensor": "drone 0"},
    {"until": 3.0},
    {"time": 5.0, "x": 13, "y": 23, "value": 4.0, "sd": 0.5, "sensor": "drone 0"},
]


def refused(error: DafwError) -> str:
    """Return the words before the first number or name of an error; raises AssertionError for one that is no line."""
    text = str(error)
    assert "\n" not in text and 0 < len(text) < LONGEST, f"an error of {len(text)} characters: {text[:200]!r}"
    return f"refused: {type(error).__name__}"


def taken(source: Any) -> str:
    """Take the readings of some cycles from a source."""
    try:
        source.suit(SPACE, GROUND, 1.0)
        memory = source.initial_memory()
        for cycle in range(CYCLES):
            request = Request(cycle, float(cycle), cycle + 1.0, SPACE, GROUND, nothing())
            got = source.collect(request, memory, np.random.default_rng(0))
            memory = got.memory
            for one in got.observations:
                assert np.isfinite(one.operator.apply(NODES[:, :1].T)).all()
                assert (one.variance > 0.0).all()
            assert all(count > 0 for count in got.left_out.values())
            assert all("\n" not in note and len(note) < LONGEST for note in got.notes)
    except NoMoreReadingsError:
        return "read"
    except ContractError:
        raise
    except DafwError as error:
        return refused(error)
    finally:
        source.end()
    return "read"


def _recorded(path: Path, rng: Random, **options: Any) -> str:
    chosen: dict[str, Any] = {"file": str(path), "sd": 1.0, "start": "first"}
    more = [{"start": None}, {"unit": "ppm"}, {"reference": "2 mg m-3"}, {"averaging": 2.0}, {"origin": "first"}]
    more += [{"repeated": "mean"}, {"entries": {"a": 0}}, {"highest": 5.0}, {"units_in_cells": True}]
    for one in (options, rng.choice([{}, {}, *more])):
        chosen |= one
    try:
        source = Recorded.from_options(**chosen)
        from dafw.commands.readings import described_rows, described_use

        described_rows(source.rows)
        described_use(source)
    except DafwError as error:
        return refused(error)
    return taken(source)


def csv(folder: Path, rng: Random) -> str:
    """Read a table of readings in CSV."""
    path = folder / "a.csv"
    data, options = rng.choice(((CSV, {}), (DATED, {"columns": {"time": "when"}, "decimal": "comma"})))
    path.write_bytes(spoiled(data, rng))
    return _recorded(path, rng, **rng.choice((options, options, {"delimiter": "space"}, {"time_format": "%H:%M*"})))


def geojson(folder: Path, rng: Random) -> str:
    """Read readings in GeoJSON."""
    path = folder / "a.geojson"
    path.write_bytes(spoiled_json(POINTS, rng) if rng.random() < 0.7 else spoiled(json.dumps(POINTS).encode(), rng))
    return _recorded(path, rng)


def netcdf(folder: Path, rng: Random) -> str:
    """Read readings in netCDF: any layout, or a file with other bytes in it."""
    path = folder / "a.nc"
    dataset(path, rng)
    if rng.random() < 0.3:
        path.write_bytes(spoiled(path.read_bytes(), rng))
    return _recorded(path, rng)


def site(folder: Path, rng: Random) -> str:
    """Read the buildings of a site."""
    from dafw.plugins.models.dispersion.site.options import SiteOptions
    from dafw.plugins.models.dispersion.site.site import load_site

    path = folder / "s.geojson"
    spoils = rng.random() < 0.8
    path.write_bytes(spoiled_json(BUILDINGS, rng) if spoils else spoiled(json.dumps(BUILDINGS).encode(), rng))
    try:
        load_site(SiteOptions(file=str(path)))
    except DafwError as error:
        return refused(error)
    return "read"


def _lines(rng: Random) -> bytes:
    """Return the messages of a feed, some of them spoiled, in another order."""
    lines = [spoiled_json(one, rng) if rng.random() < 0.3 else json.dumps(one).encode() for one in MESSAGES]
    if rng.random() < 0.3:
        rng.shuffle(lines)
    data = b"\n".join(lines) + b"\n"
    return spoiled(data, rng) if rng.random() < 0.5 else data


def _live(rng: Random, path: Path) -> Live:
    more = [{"start": "first"}, {"reference": "2 mg m-3"}, {"late": 1}, {"vehicles": ["a"]}, {"unit": "g m-3"}]
    more += [{"entries": {"a": 1}}, {"paths": {"a": [[1, 1], [99, 99]]}}, {"clock": "wall", "start": 0.0}, {"most": 2}]
    chosen = rng.choice([{}, {}, *(one for one in more if "late" not in one)])
    return Live.from_options(source=str(path), patience=0.01, **chosen)


def feed(folder: Path, rng: Random) -> str:
    """Take the readings of a feed."""
    path = folder / "feed.jsonl"
    path.write_bytes(_lines(rng) + b'\n{"end": true}\n')
    return taken(_live(rng, path))


def journal(folder: Path, rng: Random) -> str:
    """Take the readings of a journal, of another run or of this one."""
    told: list[Any] = [{"journal": 1, "zero": 7.0, "client": "a"}]
    for number, line in enumerate(_lines(rng).decode("utf-8", "replace").splitlines()):
        told.append({"cycle": number // 3, "at": 7.5 + number, "line": line, "offset": 10 * number})
        if number % 3 == 2:
            told.append({"cycle": number // 3, "end": True})
    lines = [spoiled_json(one, rng) if rng.random() < 0.05 else json.dumps(one).encode() for one in told]
    data = b"\n".join(lines) + b"\n"
    own = rng.random() < 0.5
    path = folder / (FILE if own else "other.jsonl")
    path.write_bytes(spoiled(data, rng) if rng.random() < 0.5 else data)
    source = _live(rng, folder / "feed.jsonl" if own else path)
    if own:
        (folder / "feed.jsonl").write_bytes(b'{"end": true}\n')
    try:
        source.begin(folder, lambda: False)
    except DafwError as error:
        return refused(error)
    return taken(source)


def inbox(folder: Path, rng: Random) -> str:
    """Read the inbox of a run that heard a broker, and go on with it."""
    head = {"inbox": 1, "begins": rng.choice((0, 1000)), "client": "a"}
    first = spoiled_json(head, rng) if rng.random() < 0.3 else json.dumps(head).encode()
    data = first + b"\n" + _lines(rng)
    (folder / INBOX).write_bytes(spoiled(data, rng) if rng.random() < 0.3 else data)
    try:
        opened = Inbox(folder / INBOX, rng.choice((0, 500, 1200, 10**6)), "a")
    except DafwError as error:
        return refused(error)
    (line,) = opened.put([b"after"])
    again = Inbox(folder / INBOX, opened.waiting[-1].end if opened.waiting else 0, "a")
    assert again.waiting[-1] == line
    for one in (opened, again):
        one.close(empty=False)
    return "read"


def checkpoint(folder: Path, rng: Random) -> str:
    """Read a checkpoint, and the journal of rows beside it."""
    from dafw.core.checkpoints.checkpoint_file import read_checkpoint
    from dafw.core.checkpoints.journal import entries

    kept, rows = _checkpoint(folder.parent)
    (folder / "state-000000003.npz").write_bytes(spoiled(kept, rng))
    (folder / "rows.journal").write_bytes(spoiled(rows, rng))
    said = "read"
    for read in (
        lambda: read_checkpoint(folder / "state-000000003.npz"),
        lambda: list(entries(folder / "rows.journal", len(rows))),
    ):
        try:
            read()
        except DafwError as error:
            said = refused(error)
    return said


@cache
def _checkpoint(folder: Path) -> tuple[bytes, bytes]:
    from dafw.core.checkpoints.checkpoint_file import Checkpoint, write_checkpoint
    from dafw.core.checkpoints.journal import Journal

    told = {name: {} for name in ("configuration", "versions", "pinned", "journals", "summary", "state")}
    arrays = {"a0": np.arange(6.0).reshape(2, 3), "a1": np.array(["x"])}
    write_checkpoint(folder, Checkpoint(3, {**told, "start": "none"}, arrays))
    with Journal(folder / "rows.journal") as rows:
        for number in range(3):
            rows.add({"row": number}, arrays)
    return (folder / "state-000000003.npz").read_bytes(), (folder / "rows.journal").read_bytes()


TARGETS: dict[str, Callable[[Path, Random], str]] = {
    one.__name__: one for one in (csv, geojson, netcdf, site, feed, journal, inbox, checkpoint)
}
