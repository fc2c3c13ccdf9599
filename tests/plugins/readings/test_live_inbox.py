"""The inbox of a run that hears a broker: what came before a kill and was not used is not lost."""

from __future__ import annotations

import json
import os

import pytest

from dafw.core.errors import ReadingsError, RecordError
from dafw.plugins.readings.feed import inbox
from dafw.plugins.readings.feed.inbox import FILE, Inbox, head_of
from dafw.plugins.readings.feed.messages import LONGEST


def opened(folder, taken=0):
    return Inbox(folder / FILE, taken, "the run")


def test_what_was_not_taken_is_found_again(tmp_path):
    one = opened(tmp_path)
    assert one.waiting == [] and head_of(tmp_path / FILE).client == "the run"
    lines = [*one.put([b"one", b"two"]), *one.put([b"x" * (LONGEST + 1), "drei \xfc".encode(), b"\xff"])]
    assert [line.left_out for line in lines] == ["", "", "too_long", "", ""]
    kept = (tmp_path / FILE).read_bytes()
    assert opened(tmp_path).waiting == lines
    for number, line in enumerate(lines):
        (tmp_path / FILE).write_bytes(kept)
        assert opened(tmp_path, line.end).waiting == lines[number + 1 :]


def test_places_go_on_when_the_file_is_begun_anew_or_gone(tmp_path, monkeypatch):
    monkeypatch.setattr(inbox, "LARGE", 10)
    one = opened(tmp_path)
    (first,) = one.put([b"123456789"])
    one.all_taken()
    assert head_of(tmp_path / FILE).begins == 0  # it is not large yet
    (second,) = one.put([b"1"])
    one.all_taken()
    assert head_of(tmp_path / FILE).begins == second.end == first.end + 2
    (third,) = one.put([b"2"])
    assert opened(tmp_path, second.end).waiting == [third] and third.end == second.end + 2
    one.close(empty=True)
    assert not (tmp_path / FILE).exists()
    (fourth,) = opened(tmp_path, third.end).put([b"3"])
    assert opened(tmp_path, third.end).waiting == [fourth] and fourth.end == third.end + 2


def test_what_came_is_known_again_until_much_else_came(tmp_path, monkeypatch):
    monkeypatch.setattr(inbox, "RECENT", 3)
    one = opened(tmp_path)
    (first,) = one.put([b"412"], 1)
    one.put([b"412"], 2)
    one.put([b"a", b"\xff"], 3)
    assert not one.had([b"412"], 4)  # another message with the same text
    assert not one.had([b"a"], 3) and one.had([b"a", b"\xff"], 3)
    assert one.had([b"412"], 1) and not one.had([b"412"], 1)  # it is sent again once
    again = opened(tmp_path, first.end)  # what came before a kill is known without its number, taken or not
    assert again.had([b"412"], 7) and again.had([b"\xff"], 8) and not again.had([b"b"], 9)
    for number in range(3):
        again.put([b"%d" % number], number)
    assert not again.had([b"412"], 7) and again.had([b"2"], 2)


def test_a_message_that_was_being_written_at_a_kill_is_cut_off(tmp_path):
    (line,) = opened(tmp_path).put([b"one"])
    with (tmp_path / FILE).open("ab") as stream:
        stream.write(b'{"time": 0.')
    again = opened(tmp_path)
    assert again.waiting == [line]
    (after,) = again.put([b"two"])
    assert opened(tmp_path).waiting == [line, after]


HEADS = ['"inbox": 2, "begins": 0, "client": ""', '"inbox": 1, "begins": -1, "client": ""', '"inbox": 1, "begins": 0']


@pytest.mark.parametrize("text", ["", "no inbox\n", "[]\n", "[" * 900 + "\n", *(f"{{{head}}}\n" for head in HEADS)])
def test_another_file_in_its_place_is_refused_and_left_as_it_is(text, tmp_path):
    (tmp_path / FILE).write_text(text)
    with pytest.raises(ReadingsError, match="expected the inbox of a run"):
        opened(tmp_path)
    assert (tmp_path / FILE).read_text() == text


def test_a_full_disk_leaves_no_part_of_a_message(tmp_path, monkeypatch):
    one = opened(tmp_path)
    (line,) = one.put([b"one"])
    write = os.write
    monkeypatch.setattr(os, "write", lambda stream, data: write(stream, data[:2]))
    with pytest.raises(RecordError, match="cannot be written"):
        one.put([json.dumps({"time": 1}).encode()])
    monkeypatch.undo()
    assert opened(tmp_path).waiting == [line]
