"""A live feed, a cycle at a time: what ends a cycle, bad days, and a run that was cut off."""

from __future__ import annotations

import json
import os
import threading

import numpy as np
import pytest

from dafw import ConfigurationError, Domain, Request, StateSpace, Study, Variable
from dafw.core.errors import NoMoreReadingsError, ReadingsError
from dafw.core.geography import to_degrees
from dafw.core.observation import Selection
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.models.lorenz96 import Lorenz96
from dafw.plugins.readings.feed import collecting, feed
from dafw.plugins.readings.live import Live

NODES = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0], [100.0, 100.0]])
TRIANGLES = np.array([[0, 1, 3], [0, 3, 2]], dtype=np.int32)
SPACE = StateSpace([Variable("gas", 4, units="mg m-3", coordinates=NODES, plausible=1e4)])
WALL = np.array([[40.0, 40.0], [60.0, 40.0], [60.0, 60.0], [40.0, 60.0]])
GROUND = Domain((0.0, 0.0, 100.0, 100.0), (WALL,), ("shed",), TRIANGLES, origin=(8.0, 50.0))
PLANE = 10.0 + 2.0 * NODES[:, 0] - NODES[:, 1]


def line(time, value=1.0, **more):
    return json.dumps({"time": time, "x": 10, "y": 20, "value": value, "sd": 0.5, **more})


class Feeding:
    """A source that reads a file, and the cycles that it was asked for."""

    def __init__(self, folder, *, own=False, space=SPACE, **options):
        self.space = space
        self.path, self.folder = folder / "feed.jsonl", folder if own else None
        self.options = {"source": str(self.path), **options}
        self.source = self.anew()
        self.memory, self.cycle = None, 0

    def anew(self):
        """Return the source as a new process would make it."""
        source = Live.from_options(**self.options)
        source.suit(self.space, GROUND, 1.0)
        if self.folder is not None:
            source.begin(self.folder, lambda: False)
        return source

    def write(self, *lines):
        with self.path.open("a") as stream:
            stream.write("".join(f"{one}\n" for one in lines))

    def take(self):
        nothing = Selection(indices=np.empty(0, dtype=np.int64), covariance=np.empty(0))
        request = Request(self.cycle, float(self.cycle), self.cycle + 1.0, self.space, GROUND, nothing)
        got = self.source.collect(request, self.memory, np.random.default_rng(0))
        self.memory, self.cycle = got.memory, self.cycle + 1
        return got

    def values(self):
        return [(one.time, one.values.tolist()) for one in self.take().observations]


def test_a_cycle_ends_with_a_reading_of_a_later_one_whatever_the_order(tmp_path):
    given = Feeding(tmp_path)
    given.write(line(1.0, 3), line(0.5, 1), line(0.7, 2), line(2.0, 5), line(1.5, 4), line(3.5, 6), '{"end": true}')
    assert given.values() == [(0.5, [1.0]), (0.7, [2.0]), (1.0, [3.0])]
    assert given.values() == [(1.5, [4.0]), (2.0, [5.0])]
    assert given.values() == []
    assert given.values() == [(3.5, [6.0])]
    with pytest.raises(NoMoreReadingsError, match="the feed has ended"):
        given.take()


def test_means_keep_their_span(tmp_path):
    given = Feeding(tmp_path)
    given.write(line(1.0), line(1.0, span=0.5, x=12), line(2.0), '{"end": true}')
    (first,) = given.take().observations
    assert first.operator.spans.tolist() == [0.0, 0.5]
    (second,) = given.take().observations
    assert second.operator.spans is None


def test_a_cycle_ends_with_the_word_that_all_was_sent_and_a_late_reading_keeps_its_time(tmp_path):
    given = Feeding(tmp_path)
    given.write('{"until": 1}', line(0.5), '{"until": 2}')
    assert given.values() == []
    assert given.values() == [(0.5, [1.0])]


def test_grace_waits_for_what_is_on_its_way(tmp_path):
    given = Feeding(tmp_path, grace=1.0)
    given.write(line(1.5, 2), line(0.5, 1), line(2.5, 3), '{"end": true}')
    assert given.values() == [(0.5, [1.0])]
    assert given.values() == [(1.5, [2.0])]


def test_places_are_interpolated_in_metres_and_degrees_and_entries_are_taken_as_they_are(tmp_path):
    given = Feeding(tmp_path)
    lon, lat = to_degrees(np.array([30.0, 70.0]), GROUND.origin).tolist()
    given.write(line(1), json.dumps({"time": 1, "lon": lon, "lat": lat, "value": 2, "sd": 0.5}))
    given.write(json.dumps({"time": 1, "entry": 3, "value": 3, "sd": 0.5}), '{"until": 1}')
    found = {}
    for one in given.take().observations:
        found |= dict(zip(one.values.tolist(), one.operator.apply(PLANE[np.newaxis])[0].tolist(), strict=True))
    assert found == pytest.approx({1.0: 10.0 + 20.0 - 20.0, 2.0: 10.0 + 60.0 - 70.0, 3.0: PLANE[3]}, abs=1e-6)


def test_units_backgrounds_and_detection_limits_are_those_of_files(tmp_path):
    given = Feeding(tmp_path, sensors={"a": {"background": 2.0, "detection_limit": 5.0}})
    given.write(line(1, 12, sensor="a"), line(1, 4, sensor="a"), line(1, 0.003, sensor="b", unit="g m-3"))
    given.write('{"until": 1}')
    (one,) = given.take().observations
    assert one.values == pytest.approx([10.0, 2.5, 3.0])
    assert one.variance == pytest.approx([0.25, 0.25 + 25.0 / 12.0, 500.0**2])
    assert one.operator.limits[1] == 5.0 and one.operator.sensors == ("a", "a", "b")


def test_a_limit_in_another_scale_of_temperature_is_converted_as_values_are(tmp_path):
    space = StateSpace([Variable("temperature", 4, units="K", coordinates=NODES)])
    given = Feeding(tmp_path, space=space, detection_limit=5.0)
    given.write(line(1, 2, unit="degC"), line(1, 30, unit="degC"), '{"until": 1}')
    (one,) = given.take().observations
    assert one.values == pytest.approx([275.65, 303.15])
    assert one.variance == pytest.approx([0.25 + 25.0 / 12.0, 0.25])
    assert one.operator.limits == pytest.approx([278.15, np.nan], nan_ok=True)


def test_a_vehicle_is_where_it_says_not_where_it_was_sent_nor_in_a_wall(tmp_path):
    given = Feeding(tmp_path)
    here = {"sensor": "drone 0", "value": 1}
    given.write(line(0.9, **here), json.dumps({"time": 0.8, "x": 1, "y": 2, "sensor": "drone 1"}), '{"until": 1}')
    given.write(json.dumps({"time": 1.5, "x": 50, "y": 50, "sensor": "drone 0"}), line(1.6, sensor="other"))
    given.write(json.dumps({"time": 0.1, "x": 9, "y": 9, "sensor": "drone 1"}), '{"until": 2}')
    assert {number: place.tolist() for number, place in given.take().vehicles.items()} == {0: [10, 20], 1: [1, 2]}
    got = given.take()
    assert {number: place.tolist() for number, place in got.vehicles.items()} == {0: [10, 20], 1: [1, 2]}
    assert got.left_out == {"vehicle_in_wall_or_outside": 1}


BAD = [
    ("garbage", "unreadable"),
    (line(1, float("nan")), "incomplete"),
    (line(1, 1e300), "impossible"),
    (line(1, 2e5), "impossible"),
    (line(1, 1, sd=1e-200), "impossible"),
    (line(-1e308), "impossible"),
    (line(1e300), "too_far_ahead"),
    ('{"until": 1e300}', "too_far_ahead"),
    (line(1, unit="furlong"), "unknown_unit"),
    (line(1, unit="ppm"), "unknown_unit"),
    (line(1, x=1e300), "outside"),
    (line(1, x=50, y=50), "in_building"),
    ('{"time": 1, "value": 3, "sd": 1}', "incomplete"),
    ('{"time": 1, "x": 1, "y": 1, "value": 3}', "no_sd"),
    ('{"time": 1, "entry": 4, "value": 3, "sd": 1}', "outside"),
    ("x" * 70000, "too_long"),
    ("\udcff\udcfe", "unreadable"),
]


@pytest.mark.parametrize(("text", "reason"), BAD)
def test_garbage_is_counted_and_spoils_nothing_else(tmp_path, text, reason):
    given = Feeding(tmp_path)
    with given.path.open("w", errors="surrogateescape") as stream:
        stream.write(f"{line(0.5, 7)}\n{text}\n{text}\n{line(1, 8)}\n" + '{"until": 1}\n')
    got = given.take()
    assert [one.values.tolist() for one in got.observations] == [[7.0], [8.0]]
    assert sum(got.left_out.values()) == 2 and got.left_out[reason] >= 1
    assert len(got.notes) <= 1


def test_the_same_reading_again_counts_once_also_in_a_later_cycle(tmp_path):
    given = Feeding(tmp_path)
    given.write(line(1), line(1), line(1, 2), '{"until": 1}', line(1), '{"until": 2}')
    assert [one.values.tolist() for one in given.take().observations] == [[1.0, 2.0]]
    got = given.take()
    assert not got.observations and got.left_out == {"doubled": 1}


def test_units_that_change_half_way_are_converted_and_a_unit_that_goes_missing_is_refused(tmp_path):
    given = Feeding(tmp_path)
    given.write(line(1, 2, unit="mg m-3", sensor="a"), line(1, 0.002, unit="g m-3", sensor="a", sd=1e-3))
    given.write(line(1, 3, sensor="a"), line(1, 4, sensor="b"), '{"until": 1}')
    got = given.take()
    (one,) = got.observations
    assert one.values == pytest.approx([2.0, 2.0, 4.0])
    assert got.left_out == {"unit_missing": 1}
    assert any("changed its unit from mg m-3 to g m-3" in note for note in got.notes)


def test_time_zones_meet_in_one_cycle_and_the_first_date_may_be_the_start(tmp_path):
    given = Feeding(tmp_path, start="2026-11-30T12:00:00+01:00")
    given.write(line("2026-11-30T11:00:00.5Z", 1), line("2026-11-30T06:00:01-05:00", 2), '{"until": 1}')
    assert given.values() == [(0.5, [1.0]), (1.0, [2.0])]
    first = Feeding(tmp_path / "..", start="first")
    first.path = tmp_path / "other.jsonl"
    first.options["source"] = str(first.path)
    first.source = first.anew()
    first.write(line(1000, 1), line(1000.75, 2), line(1003, 3))
    assert first.values() == [(0.0, [1.0]), (0.75, [2.0])]


def test_a_clock_that_jumps_back_makes_readings_late_and_one_that_jumps_ahead_ends_cycles(tmp_path):
    given = Feeding(tmp_path, furthest=10.0)
    given.write(line(1), line(5, 5), line(0.2, 2), line(-3600, 3), '{"until": 6}')
    assert given.values() == [(1.0, [1.0])]
    assert given.values() == [] and given.values() == [] and given.values() == []
    assert given.values() == [(-3600.0, [3.0]), (0.2, [2.0]), (5.0, [5.0])]


def test_many_readings_at_one_instant_take_a_bounded_room(tmp_path):
    given = Feeding(tmp_path, most=200)
    with given.path.open("w") as stream:
        for number in range(10000):
            stream.write(line(1, number / 10, sensor=f"s{number}") + "\n")
        stream.write('{"until": 1}\n')
    got = given.take()
    assert sum(one.values.size for one in got.observations) == 200
    assert got.left_out == {"too_many": 800, "too_many_sensors": 9000}
    assert sum(array.nbytes for array in got.memory.values()) < 1e6


def test_a_file_may_come_late_stop_be_replaced_and_come_back(tmp_path):
    given = Feeding(tmp_path)
    threading.Timer(0.1, lambda: given.write(line(1), '{"until": 1}')).start()
    assert given.values() == [(1.0, [1.0])]

    def replace():
        given.path.rename(tmp_path / "old.jsonl")
        given.write(line(2, 2), '{"until": 2}')

    threading.Timer(0.1, replace).start()
    assert given.values() == [(2.0, [2.0])]
    given.path.write_text("")
    threading.Timer(0.1, lambda: given.write(line(3, 3), '{"until": 3}')).start()
    assert given.values() == [(3.0, [3.0])]


def test_a_named_pipe_may_lose_its_writer_and_get_another(tmp_path):
    given = Feeding(tmp_path)
    os.mkfifo(given.path)

    def write(*several):
        threading.Thread(target=lambda: [given.write(one) for one in several]).start()

    write(line(1), '{"until": 1}')
    assert given.values() == [(1.0, [1.0])]
    write('{"end": true}')
    with pytest.raises(NoMoreReadingsError):
        given.take()


def test_a_silent_feed_ends_where_patience_does(tmp_path):
    given = Feeding(tmp_path, patience=0.05)
    given.write(line(0.5))
    assert given.values() == [(0.5, [1.0])]
    with pytest.raises(NoMoreReadingsError):
        given.take()


def test_a_run_that_is_asked_to_stop_does_not_wait_for_its_feed(tmp_path):
    given = Feeding(tmp_path)
    given.source.begin(tmp_path, lambda: True)
    with pytest.raises(KeyboardInterrupt):
        given.take()
    given.source.end()


class Time:
    """A clock that moves when somebody waits."""

    def __init__(self, monkeypatch):
        self.now = 1e9
        monkeypatch.setattr(feed, "monotonic", lambda: self.now)
        monkeypatch.setattr(feed, "time", lambda: self.now)
        monkeypatch.setattr(collecting, "monotonic", lambda: self.now)
        monkeypatch.setattr("dafw.plugins.readings.live.time", lambda: self.now)


class Scripted:
    """A channel whose lines come at given times of a clock."""

    offset, ended = 0, False

    def __init__(self, clock, lines):
        self.clock, self.lines = clock, list(lines)

    def next(self, seconds):
        due, text = self.lines[0] if self.lines else (np.inf, "")
        if due - 1e9 > self.clock.now - 1e9 + seconds:
            self.clock.now += max(seconds, 1e-6)
            return None
        self.clock.now = max(self.clock.now, due)
        self.lines.pop(0)
        return feed.Line(text)

    def close(self):
        pass


def test_by_the_walls_clock_a_cycle_ends_at_its_time_and_arrival_stamps_what_has_no_time(tmp_path, monkeypatch):
    clock = Time(monkeypatch)
    given = Feeding(tmp_path, clock="wall", grace=0.25)
    lines = [(0.5, json.dumps({"x": 1, "y": 2, "value": 1, "sd": 1})), (1.2, line(0.9, 2)), (1.4, line(0.8, 3))]
    channel = Scripted(clock, [(1e9 + at, text) for at, text in lines])
    monkeypatch.setattr(Live, "_connected", lambda self, state: channel)
    assert given.values() == [(pytest.approx(0.5), [1.0]), (0.9, [2.0])]
    assert 1.25 <= clock.now - 1e9 < 1.4
    assert given.values() == [(0.8, [3.0])]
    assert given.source.zero_of_run(given.memory) == 1e9


def test_a_feed_that_never_pauses_does_not_hold_the_walls_clock_up(tmp_path, monkeypatch):
    clock = Time(monkeypatch)
    given = Feeding(tmp_path, clock="wall", most=50)
    channel = Scripted(clock, [(1e9, line(0.001 * number)) for number in range(5000)])
    monkeypatch.setattr(Live, "_connected", lambda self, state: channel)
    clock.now += 3.0
    given.source.__dict__["_zero"] = 1e9
    assert len(given.values()) <= 50
    assert len(channel.lines) > 4000


def observed(got):
    return [(one.time, one.values.tolist()) for one in got.observations], dict(got.left_out)


def test_a_run_that_was_cut_off_takes_what_its_journal_has_and_goes_on(tmp_path):
    given = Feeding(tmp_path, own=True)
    lines = [line(0.1 * k, k) for k in range(1, 60)]
    given.write(*lines, "garbage", '{"until": 6}', '{"end": true}')
    whole, memories = [], [None]
    for _ in range(6):
        whole.append(observed(given.take()))
        memories.append(given.memory)
    given.source.end()
    journal = (tmp_path / "journal.jsonl").read_bytes()
    for cut in (len(journal), len(journal) // 2, 40):
        (tmp_path / "journal.jsonl").write_bytes(journal[:cut])
        for kept in (0, 2):
            done = journal[:cut].count(b'"end": true}\n')
            if kept > done:
                continue
            again = Feeding(tmp_path, own=True)
            again.memory, again.cycle = memories[kept], kept
            assert [observed(again.take()) for _ in range(6 - kept)] == whole[kept:]
            again.source.end()
        assert (tmp_path / "journal.jsonl").read_bytes().count(b'"end": true}\n') == 6


def test_a_journal_can_be_the_feed_of_another_run(tmp_path):
    given = Feeding(tmp_path, own=True)
    given.write(line(0.5), '{"until": 1}', "garbage", line(1.2, 2), '{"until": 2}', '{"end": true}')
    whole = [observed(given.take()), observed(given.take())]
    given.source.end()
    (tmp_path / "other").mkdir()
    again = Feeding(tmp_path / "other", source=str(tmp_path / "journal.jsonl"))
    assert [observed(again.take()), observed(again.take())] == whole
    with pytest.raises(NoMoreReadingsError):
        again.take()


@pytest.mark.parametrize(
    "entry",
    [
        *("7", "[]", '{"cycle": 0}', '{"cycle": 0, "at": "soon", "line": ""}', '{"cycle": 0, "at": NaN, "line": ""}'),
        *('{"cycle": 0, "at": 1' + "0" * 400 + ', "line": ""}', '{"cycle": 0, "at": 1, "line": "", "offset": -1}'),
        *('{"cycle": 0, "at": 1, "left_out": "lost", "count": -3}', '{"cycle": 1e999, "end": true}', "[" * 5000),
    ],
)
def test_a_journal_that_is_damaged_is_refused(entry, tmp_path):
    (tmp_path / "journal.jsonl").write_text('{"journal": 1, "zero": 1' + "0" * 400 + "}\n" + entry + "\n")
    source = Live(source=str(tmp_path / "journal.jsonl"), clock="wall")
    source.suit(SPACE, GROUND, 1.0)
    request = Request(0, 0.0, 1.0, SPACE, GROUND, Selection(indices=np.empty(0, dtype=int), covariance=np.empty(0)))
    with pytest.raises(ReadingsError, match="line 2: expected an entry of a journal"):
        source.collect(request, None, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"clock": "wall", "start": "first"}, "start=first"),
        ({"start": "yesterday"}, "a date in ISO 8601"),
        ({"vehicles": ["a", "a"]}, "different"),
        ({"sensors": {"a": {"response_time": 3.0}}}, "response_time"),
        ({"entries": {"a": 0}, "paths": {"b": [[0, 0], [1, 1]]}}, "not both"),
        ({"origin": [8.0, 95.0]}, "origin"),
        ({"entries": {"a": 4}}, "entry 4"),
        ({"unit": "furlong"}, "furlong"),
        ({"source": "mqtt", "mqtt": {"host": "me:secret@broker"}}, "alone"),
        ({"source": "mqtt", "mqtt": {"credentials": "/nowhere/at/all"}}, "no file"),
        ({"source": "mqtt", "mqtt": {"ca": "/nowhere/at/all", "tls": True}}, "no file"),
    ],
)
def test_wrong_options_are_refused_before_anything_is_read(options, said):
    with pytest.raises((ConfigurationError, Exception), match=said) as caught:
        Live.from_options(**options).suit(SPACE, GROUND, 1.0)
    assert caught.value.exit_status == 2
    assert "secret" not in str(caught.value)


def test_advice_for_a_broker_needs_one():
    with pytest.raises(ConfigurationError, match="goes with readings=live"):
        Study(model=Lorenz96(), truth=Lorenz96(), filter=ETKF(), members=4, cycles=1, advice=["mqtt"])
