"""Unfinished folders of killed processes in a cache are removed, and nothing else."""

import logging
import os
import signal
import subprocess
import sys
import time

import pytest

from dafw.core import making as module
from dafw.core.making import alive, making

MAKER = """
import sys
from pathlib import Path
from dafw.core.making import making
with making(Path(sys.argv[1])) as folder:
    (folder / "half").touch()
    print(folder, flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def maker(tmp_path):
    """A process that is making something in the folder ``deeper``, and its unfinished folder."""
    command = [sys.executable, "-c", MAKER, str(tmp_path / "deeper")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield process, tmp_path.joinpath(process.stdout.readline().strip())
        process.kill()


def test_a_folder_is_gone_when_the_block_ends(tmp_path):
    with making(tmp_path / "new") as folder:
        (folder / "file").touch()
    with pytest.raises(KeyError), making(tmp_path / "new"):
        raise KeyError
    assert not list((tmp_path / "new").iterdir())


def test_what_a_killed_process_left_goes_with_the_next_and_not_before(tmp_path, maker, caplog):
    caplog.set_level(logging.INFO)
    process, left = maker
    with making(tmp_path):
        assert (left / "half").exists()  # its process still runs
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert (left / "half").exists()
    with making(tmp_path) as own:
        assert not left.exists() and own.exists()
    assert caplog.text.count(f"{left}, left behind by a process that was killed, is removed") == 1


def test_what_another_machine_is_making_stays_until_it_is_old(tmp_path, maker, monkeypatch):
    process, left = maker
    process.kill()
    process.wait()
    monkeypatch.setattr(module, "_machine", lambda: "0" * 12)  # another machine, with other process numbers
    foreign = tmp_path / "making-progress"  # not a folder that ``making`` made
    foreign.mkdir()
    with making(tmp_path):
        assert left.exists()
    for folder in (left, foreign):
        os.utime(folder, times=2 * (time.time() - 1.1 * module.OLD,))
    with making(tmp_path):
        assert foreign.exists() and not left.exists()


def test_a_process_lives_until_it_was_waited_for():
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        assert alive(process.pid)
    assert not alive(process.pid)
    assert alive(1)  # process 1 may belong to another user or to us
