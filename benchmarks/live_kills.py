"""Kills live runs at many moments, lets them go on, and compares them with a run of the same messages, to the last bit.

``python -m benchmarks.live_kills [--kills N] [--seed S]`` prints a line for each run that was killed, and ends with
status 1 if one differs. Messages come while the run is down, too: late, twice, and with garbage among them; from a file
by the feed's clock and by the wall's, and through a broker, mosquitto, if there is one. Each run is compared with one
that takes the journal of the killed one; by the feed's clock also with one that was never killed: so nothing is lost.
The runs are processes of their own, ended by SIGKILL.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import random
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr
from pathlib import Path
from typing import Any

import numpy as np
from paho.mqtt.client import Client

import dafw
from benchmarks.broker import MOSQUITTO, broker, free_port
from benchmarks.kills import Ended, at_call, forked, half_an_array, started
from dafw import Study
from dafw.core.checkpoints.plan import CheckpointPlan
from dafw.core.runs import summary_of
from dafw.plugins.filters.enks import EnKS
from dafw.plugins.models.lorenz96 import Lorenz96
from dafw.plugins.observers.grid import Grid
from dafw.plugins.readings.feed import journal
from dafw.plugins.readings.feed.inbox import Inbox
from dafw.plugins.readings.feed.mqtt import Broker, BrokerOptions
from dafw.plugins.readings.feed.options import MQTT
from dafw.plugins.readings.live import Live
from dafw.plugins.readings.twin import Twin
from dafw.studies.advice import FILE as ADVICE
from dafw.studies.replaying import difference_of
from dafw.studies.running import run_study

CYCLES, EVERY, DT = 30, 4, 0.05


def study(readings: Any, **more: Any) -> Study:
    """Return a study with a smoother, whose beliefs late readings revise."""
    return Study(
        model=Lorenz96(dt=DT),
        observer=Grid(stride=4),
        filter=EnKS(window=3),
        readings=readings,
        members=12,
        cycles=CYCLES,
        seed=1000,
        **more,
    )


def messages(rng: random.Random) -> Iterator[str]:
    """Yield the lines of a feed: the readings of a twin, some late, some twice, with garbage among them."""
    held: list[str] = []
    for number, cycle in enumerate(study(Twin(), truth=Lorenz96(dt=DT))):
        end = (number + 1) * DT
        lines = [
            json.dumps({"time": end - rng.choice((0.0, 0.01, 0.02)), "entry": 4 * place, "value": value, "sd": 1.0})
            for place, value in enumerate(cycle.observation.values.tolist())
        ]
        rng.shuffle(lines)
        late, held = held, [lines.pop() for _ in range(2)]
        lines += [*late, lines[0], "no message", '{"time": 1, "entry": 3, "value": NaN}']
        lines.append(json.dumps({"entry": 2, "value": cycle.observation.values[0], "sd": 3.0}))  # it has no time
        rng.shuffle(lines)
        yield from [*lines, json.dumps({"until": end})]
    yield '{"end": true}'


def half_an_entry(own: Any, cycle: int, line: Any, *more: Any) -> None:
    """Append a part of an entry to the journal of what came."""
    own._stream.write(b'{"cycle": 3, "at": 17')
    own._stream.flush()


MOMENTS: dict[str, Callable[[random.Random], tuple[str, Callable[[], None]]]] = {}


def _moment(name: str, owner: Any, method: str, most: int, unit: str, instead: Any = None) -> None:
    def draw(rng: random.Random) -> tuple[str, Callable[[], None]]:
        number = rng.randint(1, most)
        return f"{unit} {number}", at_call(owner, method, number, instead)

    MOMENTS[name] = draw


_moment("while a cycle waits for readings", journal.Journal, "note", 350, "line")
_moment("inside an entry of the journal", journal.Journal, "note", 350, "line", half_an_entry)
_moment("before the end of a cycle is noted", journal.Journal, "end", CYCLES, "cycle")
_moment("inside a checkpoint", np.lib.format, "write_array", 60, "array", half_an_array)


def half_a_message(own: Any, parts: Any, message: int) -> None:
    """Append a part of a message to the inbox."""
    os.write(own._stream, b'{"time": 0.')


_moment("before a message is in the inbox", Inbox, "put", 350, "message")
_moment("inside a message of the inbox", Inbox, "put", 350, "message", half_a_message)
_moment("before a message is confirmed", Client, "ack", 350, "message")
BY_BROKER = [name for name in MOMENTS if "message" in name]


@contextmanager
def written(place: Path, lines: Sequence[str], seconds: float) -> Iterator[None]:
    """Append lines to a file during the block, whether anybody reads them or not; all are there at its end."""

    def write() -> None:
        for line in lines:
            with place.open("a") as stream:
                stream.write(f"{line}\n")
            time.sleep(seconds)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        yield
    finally:
        writer.join()


@contextmanager
def sent(options: BrokerOptions, lines: Sequence[str], seconds: float, begun: Path) -> Iterator[None]:
    """Send lines to a broker during the block, from when the file ``begun`` is there: the run has subscribed."""

    def send() -> None:
        while not begun.exists():
            time.sleep(0.02)
        link = Broker(options, None)
        for line in lines:
            link.publish(options.topic, line.encode())
            time.sleep(seconds)
        link.close()

    process = started(send)  # no thread, because runs are forked meanwhile
    try:
        yield
    finally:
        os.waitpid(process, 0)


def options_of(way: str, feed: Path, port: int) -> dict[str, Any]:
    """Return the options of the source of a run: ``file, feed`` or ``file, wall`` by its clock, or ``broker``."""
    options = {"source": str(feed), "clock": "feed", "patience": 20.0}
    if way == "broker":
        return options | {"source": MQTT, "mqtt": BrokerOptions(port=port, topic=feed.stem)}
    return options | ({"clock": "wall", "grace": 0.02} if way == "file, wall" else {})


def whole_run(folder: Path, **options: Any) -> None:
    """Run the study in this process, without being killed."""
    with redirect_stderr(io.StringIO()):  # it warns of the garbage
        run_study(study(Live(**options)), folder)


def go(folder: Path, options: dict[str, Any], prepare: Callable[[], None] | None, seconds: float | None) -> Ended:
    """Run the study into a folder, or go on with it, in a process of its own."""
    plan = CheckpointPlan(cycles=EVERY)
    return forked(lambda: run_study(study(Live(**options), checkpoint=plan), folder, resume=True), prepare, seconds)


def difference(one: Path, other: Path, counts: Sequence[str] = ("readings", "readings_left_out", "cycles")) -> str:
    """Return the first difference of two runs, '' if there is none."""
    if summary_of(one).get("status") != "complete":
        return f"it is {summary_of(one).get('status', 'missing')}"
    for what in counts:
        if (mine := summary_of(one)[what]) != (theirs := summary_of(other)[what]):
            return f"summary.json, {what}: {mine}, not {theirs}"
    with dafw.open_run(one) as before, dafw.open_run(other) as now:
        return difference_of(before, now, "time")


def list_of_kills() -> list[tuple[str, str]]:
    """Return the sources and the kinds of kills, in turn."""
    both = ["by the clock", "three times, by the clock"]
    by_file = [name for name in MOMENTS if name not in BY_BROKER] + both
    by_broker = [*BY_BROKER, *both] if MOSQUITTO is not None else []
    return [
        *(("file, feed", kind) for kind in by_file),
        *(("broker", kind) for kind in by_broker),
        *(("file, wall", kind) for kind in by_file),
    ]


def main(words: Sequence[str] | None = None) -> int:
    """Kill, go on, compare, print the log; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live_kills", description="Kill live runs.")
    parser.add_argument("--kills", type=int, default=20, help="how many runs are killed")
    parser.add_argument("--seed", type=int, default=0, help="seed of the moments")
    asked = parser.parse_args(words)
    rng, identical = random.Random(asked.seed), 0
    lines = list(messages(random.Random(1000)))
    row = "{:>3}  {:10} {:36} {:18} {:9} {:10} {}"
    print(row.format("", "source", "killed", "moment", "ended", "journal", "afterwards"))
    with ExitStack() as stack:
        place = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="dafw-live-kills-")))
        port = free_port()
        if MOSQUITTO is not None:
            stack.enter_context(broker(place, port, "allow_anonymous true", "max_queued_messages 0"))
        whole = place / "whole.jsonl"
        whole.write_text("\n".join(lines) + "\n")
        begun = time.monotonic()
        whole_run(place / "reference", source=str(whole))
        most = time.monotonic() - begun
        listed = list_of_kills()
        for number in range(asked.kills):
            way, kind = listed[number % len(listed)]
            folder, feed = place / f"run-{number}", place / f"feed-{number}.jsonl"
            options, moments, ended, seconds = options_of(way, feed, port), [], None, most / len(lines)
            by_broker = way == "broker"
            began = folder / ADVICE
            with sent(options["mqtt"], lines, seconds, began) if by_broker else written(feed, lines, seconds):
                for _ in range(3 if kind.startswith("three") else 1):
                    after_seconds, prepare = None, None
                    if kind in MOMENTS:
                        moment, prepare = MOMENTS[kind](rng)
                    else:
                        # A run that hears a broker connects and subscribes first.
                        after_seconds = rng.uniform(*((1.0, 2.5) if by_broker else (0.2, 0.9))) * most
                        moment = f"{after_seconds:.2f}"
                    moments.append(moment)
                    ended = go(folder, options, prepare, after_seconds)
                kept = journal.cycles_in(folder / journal.FILE)
                last = go(folder, options, None, None)
            again = place / f"again-{number}"
            whole_run(again, source=str(folder / journal.FILE), clock=options["clock"])
            found = difference(folder, again)
            if not found and options["clock"] == "feed":
                # A message that was not confirmed before the kill comes twice, and is counted as left out.
                counts = ("readings", "cycles") if by_broker else ("readings", "readings_left_out", "cycles")
                found = difference(folder, place / "reference", counts)
            identical += not found
            after = summary_of(folder).get("resumed_after") or "the start"
            said = f" ({last.said.strip().splitlines()[-1]})" if last.how != "complete" else ""
            result = f"went on after {after}: {found or 'identical'}{said}"
            print(row.format(number + 1, way, kind, ", ".join(moments), ended.how, f"{kept} cycles", result))
            sys.stdout.flush()
    print(f"{identical} of {asked.kills} identical")
    return 0 if identical == asked.kills else 1


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
