"""The page of a run that goes on: it follows the run to its end, for several viewers, on this machine alone."""

from __future__ import annotations

import fcntl
import json
import os
import re
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest
from browser import differ, open_page
from made_forecasts import forecasts
from playwright.sync_api import expect
from served import ask, served
from waiting import PATIENCE

from dafw.commands import main
from dafw.core.errors import ConfigurationError, RunError
from dafw.views.watch import Following, Server


def record(run, folder, rows, status="interrupted"):
    """Write the first rows of a run as if it went on; readers see the old file or the new one."""
    run.isel(time=slice(0, rows)).to_netcdf(folder / "beside.nc")
    (folder / "beside.nc").rename(folder / "run.nc")
    (folder / "summary.json").write_text(json.dumps({"status": status, "cycles": rows - 1}))


def serving(folder):
    """Serve the run in a folder."""
    return served(Server(Following(folder)))


@contextmanager
def ended(process):
    """Kill a process that a failed test leaves behind."""
    with process:
        try:
            yield process
        finally:
            process.kill()


def test_the_page_follows_the_run_for_several_viewers(browser, plant_run, tmp_path):
    record(plant_run, tmp_path, 6)
    with serving(tmp_path) as server:
        viewers = [open_page(browser, server.address) for _ in range(2)]
        for page in viewers:
            assert "t = 25 of 25 s" in page.text("#now") and "following" in page.text("#subtitle")
        viewers[1].go(2)
        viewers[0].find(".map[data-key=mean] .layers").click(position={"x": 150, "y": 100})
        before = viewers[0].pixels(".map[data-key=truth] canvas >> nth=0")
        record(plant_run, tmp_path, 21, "complete")
        expect(viewers[0].find("#now")).to_contain_text("t = 100 of 100 s")
        expect(viewers[1].find("#now")).to_contain_text("t = 10 of 100 s")
        for page in viewers:
            expect(page.find("#subtitle")).to_contain_text("complete")
            page.drawn()
            assert page.find(".chart[data-id=err]").count() == 1 and "20" in page.text("#words")
            assert page.complaints == [] and all(request.startswith(server.address) for request in page.requests)
        assert (before != viewers[0].pixels(".map[data-key=truth] canvas >> nth=0")).any()
        asked = len(viewers[0].requests)
        late = open_page(browser, server.address)
        assert "complete" in late.text("#subtitle") and "following" not in late.text("#subtitle")
        late.tab.context.close()
    viewers[0].tab.wait_for_timeout(100)
    assert len(viewers[0].requests) == asked, "a run that has ended is not asked for any more"
    for page in viewers:
        page.tab.context.close()


def test_forecasts_come_as_soon_as_they_are_made(browser, plant_run, tmp_path):
    def foresee(issues):
        forecasts(plant_run, issues).to_netcdf(tmp_path / "beside.nc")
        (tmp_path / "beside.nc").rename(tmp_path / "forecast.nc")

    record(plant_run, tmp_path, 1)
    with served(Server(Following(tmp_path, used=lambda: 0.0))) as server:  # reading takes no time
        page = open_page(browser, server.address)
        assert page.find("#forecast").is_hidden() and "reading" not in page.text(".marks")
        record(plant_run, tmp_path, 3)
        expect(page.find("#now")).to_contain_text("t = 10 of 10 s", timeout=1000.0 * PATIENCE)
        assert "reading" in page.text(".marks") and page.find("#forecast").is_hidden()
        foresee([10.0])  # the row of its time has been recorded before
        hint = page.find("#forecast .hint")
        expect(hint).to_contain_text("Made at t = 10 s", timeout=1000.0 * PATIENCE)
        page.find("#forecast").scroll_into_view_if_needed()
        page.find("#forecast-threshold").select_option("1")
        page.find("#forecast-lead").select_option("0")
        page.drawn()
        first = page.pixels("#forecast canvas >> nth=0")
        record(plant_run, tmp_path, 10)
        expect(page.find("#now")).to_contain_text("t = 45 of 45 s", timeout=1000.0 * PATIENCE)
        expect(page.find("#subtitle")).to_contain_text("45 s · following")
        assert "Made at t = 10 s" in hint.inner_text()
        foresee([10.0, 45.0])
        expect(hint).to_contain_text("Made at t = 45 s", timeout=1000.0 * PATIENCE)
        assert [page.find(f"#forecast-{name}").input_value() for name in ("threshold", "lead")] == ["1", "0"]
        page.drawn()
        assert differ(first, page.pixels("#forecast canvas >> nth=0")) > 0.02
        page.go(2)  # what was known then stays
        assert "Made at t = 10 s" in hint.inner_text()
        assert differ(first, page.pixels("#forecast canvas >> nth=0")) == 0.0
        record(plant_run, tmp_path, 21, "complete")
        expect(page.find("#subtitle")).to_contain_text("complete", timeout=1000.0 * PATIENCE)
        assert page.complaints == []
    page.tab.context.close()


def test_a_page_whose_server_is_closed_says_so(browser, ring_run, tmp_path):
    record(ring_run, tmp_path, 6)
    with serving(tmp_path) as server:
        page = open_page(browser, server.address)
    expect(page.find("#subtitle")).to_contain_text("the server was closed")
    page.go(2)
    assert page.find("#profile").is_visible()
    page.tab.context.close()


def test_it_answers_this_machine_and_its_own_name_only(plant_run, tmp_path):
    record(plant_run, tmp_path, 3)
    with serving(tmp_path) as server:
        assert server.server_address[0] == "127.0.0.1"
        port = server.server_port
        assert ask(server, "/")[0] == 200 and ask(server, "/", Host=f"localhost:{port}")[0] == 200
        assert ask(server, "/", Host=f"elsewhere.example:{port}")[0] == 403
        for path in ("/run.nc", "/../run.nc", "/data/x", "//etc/passwd"):
            assert ask(server, path)[0] == 404
        data = json.loads(ask(server, "/data")[1])
        assert ask(server, f"/data?state={data['live']['state'].replace(' ', '%20')}") == (204, "")
        assert ask(server, "/data?state=other")[0] == 200
        with pytest.raises(ConfigurationError, match=f"port {port} cannot be used"):
            Server(Following(tmp_path), port)


def test_reading_takes_a_small_share_of_the_time(plant_run, tmp_path, monkeypatch):
    now = [0.0]

    def read(file):
        now[0] += 2.0
        return load(file)

    from dafw.views import watch

    load = watch.load_run
    monkeypatch.setattr(watch, "load_run", read)
    following = Following(tmp_path, clock=lambda: now[0], used=lambda: now[0])
    record(plant_run, tmp_path, 3)
    assert len(following.data()["time"]["values"]) == 3
    record(plant_run, tmp_path, 4)
    assert len(following.data()["time"]["values"]) == 4, "the first reading does not count"
    record(plant_run, tmp_path, 5)
    now[0] += 10.0
    assert len(following.data()["time"]["values"]) == 4, "a reading took 2 s, so the next is due after 20"
    now[0] += 10.5
    assert len(following.data()["time"]["values"]) == 5
    record(plant_run, tmp_path, 6, "failed")
    found = following.data()
    assert len(found["time"]["values"]) == 6 and found["live"]["ended"]


def test_what_cannot_be_read_for_a_moment_is_read_later(plant_run, tmp_path):
    now = [0.0]
    following = Following(tmp_path, clock=lambda: now[0])
    with pytest.raises(RunError, match="holds no run"):
        following.data()
    record(plant_run, tmp_path, 3)
    following.data()
    (tmp_path / "run.nc").write_bytes(b"half of a")
    now[0] += 1000.0
    assert len(following.data()["time"]["values"]) == 3
    record(plant_run, tmp_path, 4)
    now[0] += 1000.0
    assert len(following.data()["time"]["values"]) == 4


def test_a_file_that_another_process_writes_is_read(plant_run, tmp_path):
    record(plant_run, tmp_path, 3)
    variables = {name: value for name, value in os.environ.items() if name != "HDF5_USE_FILE_LOCKING"}
    program = f"from dafw.views.watch import *; print(len(Following(Path({str(tmp_path)!r})).data()['time']['values']))"
    with (tmp_path / "run.nc").open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)  # as HDF5 locks what it writes
        command = [sys.executable, "-c", program]
        done = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=PATIENCE)
    assert (done.stdout, done.stderr) == ("3\n", "")


def test_the_command_follows_a_real_run_to_its_end_and_closes_on_an_interrupt(browser, tmp_path):
    folder = tmp_path / "real"
    folder.mkdir()
    dafw = [sys.executable, "-m", "dafw"]
    words = ["experiment=lorenz96", "cycles=400", "members=20", "pictures=false", f"hydra.run.dir={folder}"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    told = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # Shells start what they put into the background with Ctrl-C ignored; it must end the command all the same.
    in_background = ["sh", "-c", 'trap "" INT; exec "$@"', "sh"]
    with ended(subprocess.Popen([*in_background, *dafw, "watch", str(folder)], **told)) as watching:
        assert watching.stderr.readline() == f"dafw: waiting for a run in {folder}\n"
        with ended(subprocess.Popen([*dafw, "run", *words], **quiet)) as running:
            address = watching.stdout.readline().strip()
            assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", address)
            page = open_page(browser, address)
            expect(page.find("#subtitle")).to_contain_text("complete", timeout=1000.0 * PATIENCE)
            expect(page.find("#now")).to_contain_text("of 20 s")  # opened after the end, a page begins at the start
            assert running.wait(PATIENCE) == 0 and page.complaints == []
        page.tab.context.close()
        watching.send_signal(signal.SIGINT)
        out, err = watching.communicate(timeout=PATIENCE)
        assert (watching.returncode, out, err) == (0, "", "")


def test_a_folder_that_is_not_there_is_refused(tmp_path, capsys):
    assert main(["watch", str(tmp_path / "nowhere")]) == 2
    assert capsys.readouterr().err == f"dafw: {tmp_path / 'nowhere'}: holds no run (expected a run's folder)\n"
