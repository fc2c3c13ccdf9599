"""A real broker: readings and advice through it, links that drop, TLS, and credentials that stay secret."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from benchmarks.broker import MOSQUITTO, broker, free_port
from dafw import Study
from dafw.core.errors import ReadingsError, RecordError
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.models.lorenz96 import Lorenz96
from dafw.plugins.observers.grid import Grid
from dafw.plugins.readings.feed import mqtt
from dafw.plugins.readings.feed.inbox import FILE, Inbox
from dafw.plugins.readings.feed.mqtt import Broker, BrokerOptions
from dafw.plugins.readings.live import Live
from dafw.plugins.readings.twin import Twin
from dafw.studies.running import run_study
from dafw.studies.simulating import Advised, Simulation, line_of

pytestmark = pytest.mark.skipif(MOSQUITTO is None, reason="there is no broker: mosquitto is not installed")
PATIENCE = 60.0
ROOT = Path(__file__).parents[3]


@contextmanager
def link(port, topic="dafw/readings", **more):
    made = Broker(BrokerOptions(port=port, **more), topic)
    try:
        yield made
    finally:
        made.close()


def heard(channel):
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        if (line := channel.next(0.2)) is not None:
            return line
    raise TimeoutError


def test_a_run_and_its_simulation_meet_at_a_broker(tmp_path):
    port = free_port()
    study = {"model": Lorenz96(), "observer": Grid(stride=8), "filter": ETKF(), "members": 8, "cycles": 5, "seed": 1000}
    parts, vehicle = Study(**study, truth=Lorenz96(), readings=Twin()).prepare()
    live = Live.from_options(source="mqtt", mqtt={"port": port}, patience=PATIENCE)
    truths = []
    with broker(tmp_path, port), link(port, "dafw/advice") as channel:

        def send(message):
            channel.publish("dafw/readings", line_of(message))

        kept = type("Kept", (), {"append": lambda self, truth: truths.append(truth)})()
        simulation = Simulation(parts, vehicle, live, 5, send, Advised(channel), kept)
        thread = threading.Thread(target=simulation.play)
        thread.start()
        summary = run_study(Study(**study, readings=live), tmp_path / "run")
        thread.join(PATIENCE)
        with link(port, "dafw/advice") as late:
            assert json.loads(heard(late).text)["end"]  # the broker keeps the last advice
    assert summary["readings"]["on_time"] == 25 and summary["readings_left_out"] == {}
    assert len(truths) == 6


def test_what_is_sent_while_the_link_is_down_comes_later_and_a_broker_may_be_started_again(tmp_path):
    port = free_port()
    with broker(tmp_path, port), link(port) as channel, link(port, "other") as sender:
        sender.publish("dafw/readings", b"1")
        assert heard(channel).text == "1"
        channel._client._sock_close()  # the link drops, and comes back by itself
        sender.publish("dafw/readings", b"2")
        # A message whose receipt was not confirmed comes twice.
        assert next(line.text for line in iter(lambda: heard(channel), None) if line.text != "1") == "2"
    with link_to_nobody(port) as channel, broker(tmp_path, port), link(port, "other") as sender:
        waited_for(channel._heard.is_set)
        sender.publish("dafw/readings", b"3")
        assert heard(channel).text == "3"


def waited_for(condition):
    deadline = time.monotonic() + PATIENCE
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert condition()


def test_a_link_whose_process_was_killed_goes_on_with_what_the_broker_kept(tmp_path):
    port = free_port()
    options = BrokerOptions(port=port)
    with broker(tmp_path, port), link(port, "other") as sender:
        killed = Broker(options, "dafw/readings", "the run")
        assert not killed.kept
        killed._client.loop_stop()  # no word of leaving
        killed._client._sock_close()
        for number in range(50):
            sender.publish("dafw/readings", b"%d" % number)
        again = Broker(options, "dafw/readings", "the run", goes_on=True)
        assert again.kept
        assert [again.next(0.0).text for _ in range(50)] == [str(number) for number in range(50)]
        again.close()
        other = Broker(options, "dafw/readings", "another run", goes_on=True)
        assert not other.kept and other.next(0.0) is None
        other.close()


@contextmanager
def link_to_nobody(port):
    first, mqtt.FIRST = mqtt.FIRST, 0.1
    try:
        with link(port) as channel:
            yield channel
    finally:
        mqtt.FIRST = first


def test_a_message_of_ten_megabytes_and_a_flood_are_counted_and_take_a_bounded_room(tmp_path, monkeypatch):
    monkeypatch.setattr(mqtt, "HELD", 50_000)
    port = free_port()
    with broker(tmp_path, port), link(port) as channel, link(port, "other") as sender:
        sender.publish("dafw/readings", b"x" * 10_000_000)
        sender.publish("dafw/readings", b"a\nb\n\nc")
        assert [heard(channel).left_out, *(heard(channel).text for _ in range(3))] == ["too_long", "a", "b", "c"]
        for _ in range(20):
            sender.publish("dafw/readings", b"y" * 10_000)
        waited_for(lambda: channel._lost + len(channel._lines) == 20)
        assert channel._held <= 50_000
        assert [heard(channel).left_out for _ in range(4)] == ["", "", "", ""]
        lost = heard(channel)
        assert (lost.left_out, lost.count) == ("lost", 16)


def test_credentials_come_from_a_file_or_the_environment_and_reach_no_file_of_the_run(tmp_path, monkeypatch, capfd):
    port, secret = free_port(), "pass word-4711"
    passwords = tmp_path / "passwords"
    subprocess.run(["mosquitto_passwd", "-c", "-b", passwords, "carla", secret], check=True, capture_output=True)
    passwords.chmod(0o644)
    given = tmp_path / "credentials"
    given.write_text(f"carla\n{secret}\n")
    protected = ("allow_anonymous false", f"password_file {passwords}")
    with broker(tmp_path, port, *protected):
        with pytest.raises(ReadingsError, match="refuses the link") as caught, link(port):
            pass
        given.write_text("carla\nwrong-4712\n")
        with pytest.raises(ReadingsError, match="refuses the link") as wrong, link(port, credentials=str(given)):
            pass
        assert "4712" not in str(wrong.value) + str(caught.value)
        given.write_text(f"carla\n{secret}\n")
        live = Live.from_options(source="mqtt", mqtt={"port": port, "credentials": str(given)}, patience=0.5)
        study = Study(model=Lorenz96(), readings=live, filter=ETKF(), members=4, cycles=3)
        run_study(study, tmp_path / "run")
        monkeypatch.setenv(mqtt.USER, "carla")
        monkeypatch.setenv(mqtt.PASSWORD, secret)
        with link(port, "a") as one:
            one.publish("a", b"heard")
            assert heard(one).text == "heard"
    files = [path for path in (tmp_path / "run").rglob("*") if path.is_file()]
    assert len(files) > 3
    assert not [path for path in files if b"4711" in path.read_bytes()]
    assert "4711" not in "".join(capfd.readouterr())
    given.write_text("\n")
    with pytest.raises(ReadingsError, match="first line"), link(port, credentials=str(given)):
        pass


# paho leaves the socket of a link that TLS refuses to whoever collects it.
@pytest.mark.filterwarnings("ignore:unclosed <ssl.SSLSocket:ResourceWarning")
def test_the_link_can_be_encrypted_and_a_broker_that_nobody_vouches_for_is_refused(tmp_path):
    if shutil.which("openssl") is None:
        pytest.skip("there is no openssl to make a certificate")
    words = "req -x509 -newkey rsa:2048 -nodes -days 2 -keyout key.pem -out cert.pem -subj /CN=localhost"
    names = ["-addext", "subjectAltName=IP:127.0.0.1,DNS:localhost"]
    subprocess.run(["openssl", *words.split(), *names], cwd=tmp_path, check=True, capture_output=True)
    (tmp_path / "key.pem").chmod(0o644)
    port = free_port()
    files = [f"certfile {tmp_path}/cert.pem", f"keyfile {tmp_path}/key.pem", "allow_anonymous true"]
    with broker(tmp_path, port, *files):
        with link(port, "a", tls=True, ca=str(tmp_path / "cert.pem")) as one:
            one.publish("a", b"heard")
            assert heard(one).text == "heard"
        with pytest.raises(ReadingsError, match="cannot be trusted"), link(port, tls=True):
            pass
    (tmp_path / "no.pem").write_text("no certificate")
    with pytest.raises(ReadingsError, match="no certificate that can be read"):
        Broker(BrokerOptions(port=port, tls=True, ca=str(tmp_path / "no.pem")), "a")


def test_the_benchmark_of_load_sends_and_counts_every_reading():
    words = ["--experiment", "lorenz96", "--seconds", "1", "--speed", "0", "--rate", "40", "--sd", "1", "--most", "1e9"]
    command = [sys.executable, "-m", "benchmarks.live_load", *words, "members=8"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    head, *rows, count, lag = done.stdout.splitlines()
    assert "lag by the processor" in head and len(rows) == 10
    assert count.startswith("400 readings sent, 400 taken") and count.endswith("left out: none")
    assert lag.startswith("lag by the processor, in cycles, of ") and ", at most " in lag


def dropped(channel):
    """End a link as a kill does: no word of leaving, nothing is closed."""
    channel._client._sock_close()
    channel._client.loop_stop()


def test_what_was_confirmed_and_not_used_before_a_kill_is_in_the_inbox_and_what_was_not_confirmed_comes_again(tmp_path):
    port = free_port()
    options = BrokerOptions(port=port)

    def heard_by(taken, *, goes_on):
        inbox = Inbox(tmp_path / FILE, taken, "the run")
        return Broker(options, "dafw/readings", "the run", goes_on=goes_on, inbox=inbox)

    with broker(tmp_path, port), link(port, "other") as sender:
        killed = heard_by(0, goes_on=False)
        for number in range(5):
            sender.publish("dafw/readings", b"%d" % number)
        waited_for(lambda: len(killed._lines) == 5)
        assert [killed.next(0.0).text for _ in range(2)] == ["0", "1"]
        taken = killed.offset  # as the journal has it
        # The next message is in the inbox when the run is killed, and the broker is not told.
        killed._client.ack = lambda mid, qos: None
        sender.publish("dafw/readings", b"5")
        waited_for(lambda: len(killed._lines) == 4)
        dropped(killed)
        sender.publish("dafw/readings", b"6")
        again = heard_by(taken, goes_on=True)
        # The broker sends the fifth again, because nobody told it; but it is in the inbox, so it counts once.
        assert [heard(again).text for _ in range(5)] == ["2", "3", "4", "5", "6"]
        assert again.kept and again.next(0.0) is None
        again.close()
        assert not (tmp_path / FILE).exists()  # all of it is taken


def test_a_message_that_cannot_be_kept_is_not_confirmed_and_the_run_ends(tmp_path, monkeypatch):
    port = free_port()
    options = BrokerOptions(port=port)
    with broker(tmp_path, port), link(port, "other") as sender:
        full = Broker(options, "dafw/readings", "the run", inbox=Inbox(tmp_path / FILE, 0, "the run"))
        monkeypatch.setattr(Inbox, "put", lambda own, parts, message: full_disk())
        sender.publish("dafw/readings", b"1")
        waited_for(lambda: full._unwritable is not None)
        monkeypatch.undo()
        sender.publish("dafw/readings", b"2")  # nor is a later one, which would come before it
        with pytest.raises(RecordError, match="no space"):
            full.next(1.0)
        dropped(full)
        again = Broker(options, "dafw/readings", "the run", goes_on=True, inbox=Inbox(tmp_path / FILE, 0, "the run"))
        assert [heard(again).text for _ in range(2)] == ["1", "2"]
        again.close()


def full_disk():
    raise RecordError("no space")
