"""Messages of a feed: what they say, and that no text whatever does more than be left out."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dafw.plugins.readings.feed.lines import Splitter
from dafw.plugins.readings.feed.messages import LONGEST, Message, UnusableError, names_of, read_message
from dafw.plugins.readings.feed.state import RECENT, FeedState, Reading
from dafw.plugins.readings.files.options import ColumnOptions

NAMES = names_of(ColumnOptions())


def read(text, **options):
    return read_message(text, NAMES, **options)


def test_a_reading_has_what_it_says():
    text = '{"time": 5, "x": "1.5", "y": 2, "value": "0.25", "sd": 0.1, "unit": "ppm", "sensor": 3, "battery": 80}'
    assert read(text) == Message(5.0, 0.25, 0.1, "ppm", "3", "metres", (1.5, 2.0))


def test_a_value_may_be_a_mean():
    assert read('{"time": 5, "value": 1, "span": "2.5"}').span == 2.5
    assert read('{"time": 5, "value": 1}').span == read('{"time": 5, "value": 1, "span": null}').span == 0.0


def test_keys_are_found_in_any_case_and_under_other_names():
    assert read('{"TIME": 5, "Longitude": 8, "LAT": 50, "value": 1}').place == (8.0, 50.0)
    names = names_of(ColumnOptions(value="CO2"))
    assert read_message('{"time": 5, "co2": 7}', names).value == 7.0


@pytest.mark.parametrize(
    ("time", "hour"),
    [
        ("2026-11-30T12:00:00Z", 12),
        ("2026-11-30T12:00:00", 12),
        ("2026-11-30T12:00:00+02:00", 10),
        ("2026-11-30T06:30:00-05:30", 12),
    ],
)
def test_a_date_is_what_its_zone_makes_of_it(time, hour):
    assert read(json.dumps({"time": time, "value": 1})).time == datetime(2026, 11, 30, hour, tzinfo=UTC)


def test_a_message_without_a_value_says_where_a_sensor_is():
    assert read('{"time": 5, "x": 1, "y": 2, "sensor": "drone 0"}').value is None
    assert read('{"until": 7}').until == 7.0
    assert read('{"end": true}').end


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "unreadable"),
        ("7", "unreadable"),
        ("[" * 60000, "unreadable"),
        ('{"time": 1, "value": 1', "unreadable"),
        ("9" * 6000, "unreadable"),
        ('{"time": NaN, "value": 1}', "incomplete"),
        ('{"time": 1, "value": NaN}', "incomplete"),
        ('{"time": 1, "value": null}', "incomplete"),
        ('{"time": 1}', "incomplete"),
        ('{"time": 1, "x": 3, "y": 4}', "incomplete"),
        ('{"until": null}', "incomplete"),
        ('{"time": 1, "value": Infinity}', "wrong_number"),
        ('{"time": 1, "value": true}', "wrong_number"),
        ('{"time": 1, "value": "1_0"}', "wrong_number"),
        ('{"time": 1, "value": [1]}', "wrong_number"),
        ('{"time": "soon", "value": 1}', "wrong_time"),
        ('{"time": 1, "value": 1, "lat": 95, "lon": 8}', "impossible"),
        ('{"time": 1, "value": 1, "sd": 0}', "impossible"),
        ('{"time": 1, "value": 1, "entry": 1.5}', "impossible"),
        ('{"time": 1, "value": 1, "span": -1}', "impossible"),
        ('{"time": 1, "value": 1, "sensor": "a\\u0000"}', "wrong_text"),
        ('{"time": 1, "value": 1, "unit": {"a": 1}}', "wrong_text"),
    ],
)
def test_what_cannot_be_used_is_left_out_with_its_reason(text, reason):
    with pytest.raises(UnusableError) as caught:
        read(text)
    assert caught.value.reason == reason
    assert len(str(caught.value)) < 200


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.sampled_from([*NAMES, "other"]) | st.text(), inner),
    max_leaves=8,
)


@settings(max_examples=100, deadline=None)
@given(st.text() | JSON.map(json.dumps))
def test_no_text_raises_another_error(text):
    try:
        found = read(text)
    except UnusableError:
        return
    assert found.end or found.until is not None or found.value is not None or found.sensor


@settings(max_examples=50, deadline=None)
@given(st.lists(st.binary(max_size=20)), st.lists(st.integers(0, 400), max_size=8))
def test_lines_do_not_depend_on_how_their_bytes_are_cut(lines, cuts):
    data = b"\n".join(lines)
    whole, pieces, at = Splitter(), Splitter(), [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    one = [*whole.feed(data), *whole.finish()]
    many = [line for start, end in pairwise(at) for line in pieces.feed(data[start:end])]
    assert one == [*many, *pieces.finish()]
    wanted = [part for part in data.split(b"\n") if part.strip()]
    assert [line.text.encode("utf-8", "surrogateescape") for line in one] == wanted


def test_of_a_line_of_ten_megabytes_nothing_is_kept():
    splitter, found, most = Splitter(), [], 0
    for _ in range(160):
        found += splitter.feed(b"x" * 65536)
        most = max(most, splitter.held)
    found += splitter.feed(b'\n{"until": 1}\n')
    assert most <= LONGEST
    assert [(line.text, line.left_out) for line in found] == [("", "too_long"), ('{"until": 1}', "")]
    assert found[-1].end == 160 * 65536 + 14


def test_what_a_feed_remembers_survives_a_file():
    state = FeedState(entries=3, zero=1.5e9, seconds=0.1, vehicles={1: (1.0, 2.0, 3.0)}, units={"a": "ppm"})
    state.waiting.append(Reading(9.0, 0.1 + 0.2, None, "", "a", "metres", (1.0, 2.0), 2.5))
    for digest in range(RECENT + 5):
        state.remember(digest + 2**63)
    again = FeedState.of(state.memory())
    assert again == state
    assert len(again.recent) == RECENT and not again.is_known(2**63 + 4) and again.is_known(2**63 + 5)
