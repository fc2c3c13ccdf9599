"""Progress bars: on a terminal only; tasks that are done once are also logged."""

import io
import logging
import os
import pty
import subprocess
import sys

import pytest

from dafw.core.progress import long_task, progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def a_terminal(monkeypatch):
    """Put one in the place of standard error; in the test itself, because pytest does the same before it."""
    monkeypatch.setattr("sys.stderr", screen := Terminal())
    return screen


def test_a_terminal_shows_what_is_done_and_how_much_of_it(monkeypatch):
    terminal = a_terminal(monkeypatch)
    with progress(4, "wind", "solving") as bar:
        bar.update(4)
    last = terminal.getvalue().split("\r")[-1]
    assert last.startswith("solving: 100%") and "4/4" in last and "wind" in last


def test_what_was_done_before_counts(monkeypatch):
    terminal = a_terminal(monkeypatch)
    with progress(4, "run", done=3) as bar:
        bar.update()
    assert "3/4" in terminal.getvalue() and "4/4" in terminal.getvalue()


def test_what_cannot_be_counted_shows_the_time(monkeypatch):
    terminal = a_terminal(monkeypatch)
    with long_task("making the mesh"):
        assert "making the mesh: 00:00" in terminal.getvalue()


def test_a_terminal_that_does_not_know_its_size_shows_it_as_well():
    program = "from dafw.core.progress import progress; progress(3, 'wind', 'solving').close()"
    ours, theirs = pty.openpty()  # its size is 0 x 0
    with os.fdopen(theirs, "wb") as screen:
        subprocess.run([sys.executable, "-c", program], stderr=screen, check=True)
        shown = os.read(ours, 1024)
    os.close(ours)
    assert b"solving:   0%" in shown and b"0/3" in shown


def test_without_a_terminal_nothing_is_printed(capsys):
    with long_task("making the mesh"), progress(2, "cycle") as bar:
        bar.update()
    assert capsys.readouterr() == ("", "")


def test_a_long_task_is_logged_before_and_after(caplog):
    caplog.set_level(logging.INFO, "dafw")
    with long_task("making the mesh"):
        assert caplog.messages == ["making the mesh"]
    assert caplog.messages[1].startswith("making the mesh: ") and caplog.messages[1].endswith(" s")


def test_a_task_that_fails_is_not_logged_as_done(caplog):
    caplog.set_level(logging.INFO, "dafw")
    with pytest.raises(ValueError, match="no mesh"), long_task("making the mesh"):
        raise ValueError("no mesh")
    assert caplog.messages == ["making the mesh"]
