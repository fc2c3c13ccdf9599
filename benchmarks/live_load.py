"""How far a live run is behind its feed, and what memory it takes, while many sensors send through a broker.

``python -m benchmarks.live_load [--sensors 10] [--rate 10] [--seconds 600] [--speed 1] [WORDS...]`` starts mosquitto on
the loopback device and ``dafw run experiment=live readings.source=mqtt WORDS`` beside it, and sends what the sensors of
a truth read, ``rate`` times a second each. It prints a table over time: readings sent, the lag, and the resident memory
of the run and of the broker.

A cycle's lag is the time from its last reading to the advice that has used it, in cycles. It is told twice: by the
clock, and by the processor: that of a run which waits for nothing but readings and its own computing, whose seconds are
those that the process has used. On a machine with other work only the second means something. ``--speed 8`` lets eight
seconds of the study pass in one of the clock; ``--speed 0`` sends as soon as the run is less than two cycles behind,
and then only the lag by the processor is told. The exit status is 1 if a reading was lost, or a lag was above
``--most`` (2) cycles after the first ``--warm`` (0) cycles.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.broker import broker, free_port
from dafw.core.composition import compose, study_part
from dafw.core.cycle import TRUTH_ERROR
from dafw.core.experiment import study_from
from dafw.core.runs import summary_of
from dafw.plugins.readings.feed.mqtt import Broker, BrokerOptions

PATIENCE = 600.0


class Sensors:
    """Sensors at nodes of a truth, which is stepped a cycle at a time."""

    def __init__(self, words: Sequence[str], count: int, sd: float = 1.0) -> None:
        self._sd = sd
        composed = study_part(compose(words))
        study = study_from({**composed, "readings": {"name": "twin"}})
        self._parts, _ = study.prepare()
        self._truth = self._parts.truth.first_guess(1, self._parts.streams.members("initial truth", 0))
        self.dt, self.cycles, self._cycle = self._parts.model.dt, study.cycles, 0
        variable = self._parts.model.space.variables[0]
        self._nodes = np.linspace(0, variable.size - 1, count).astype(int)
        self._places: list[dict[str, Any]] = [{"entry": int(node)} for node in self._nodes]
        if variable.coordinates is not None and variable.coordinates.shape[1] == 2:
            places = np.asarray(variable.coordinates)[self._nodes]
            self._places = [{"x": x, "y": y} for x, y in places.tolist()]
        self._rng = np.random.default_rng(1000)

    def step(self) -> None:
        """Go on to the end of the next cycle."""
        parts, truth = self._parts, self._truth
        errors = parts.streams.members(TRUTH_ERROR, self._cycle)
        self._truth = parts.truth.forecast(truth.ensemble, truth.memory, errors)
        self._cycle += 1

    def read(self, moment: float) -> Iterator[bytes]:
        """Yield a message of each sensor."""
        values = self._parts.seen(self._truth).members[0, self._nodes]
        for number, (place, value) in enumerate(zip(self._places, values.tolist(), strict=True)):
            told = {"value": value + self._sd * self._rng.standard_normal(), "sd": self._sd, "sensor": f"s{number}"}
            yield json.dumps({"time": moment, **place, **told}).encode()


def resident(process: int) -> float:
    """Return the resident memory of a process in MB; 0 when it has ended."""
    try:
        return psutil.Process(process).memory_info().rss / 1e6
    except psutil.Error:
        return 0.0


class Watched:
    """The advice that arrives: how far behind the sensors each belief is, in cycles, by the clock and the processor."""

    def __init__(self, link: Broker, dt: float) -> None:
        self._link, self._dt = link, dt
        self.lags: list[tuple[float, float, float]] = []
        self.cycle, self.ended = -1, False
        self._used, self._done = 0.0, 0.0

    def look(self, now: float, process: int) -> None:
        """Take the advice that has come by the time ``now`` of the sensors (s); ``process`` is that of the run."""
        while (line := self._link.next(0.0)) is not None:
            told = json.loads(line.text)
            self.ended = bool(told.get("end"))
            if "cycle" not in told:
                continue
            used = processor_seconds(process, self._used)
            time, self.cycle = told["time"], told["cycle"]
            # The run begins with a cycle when it is done with the one before and has its readings.
            self._done = max(self._done, time) + (used - self._used if self.cycle else 0.0)
            self._used = used
            self.lags.append((time, (now - time) / self._dt, (self._done - time) / self._dt))

    def most(self, first: float, last: float = np.inf) -> tuple[float, float]:
        """Return the largest lags of the beliefs of a time."""
        found = [one[1:] for one in self.lags if first <= one[0] < last]
        return tuple(np.max(found, axis=0)) if found else (np.nan, np.nan)


def processor_seconds(process: int, before: float) -> float:
    """Return the seconds of the processor that a process has used; ``before`` when it has ended."""
    try:
        times = psutil.Process(process).cpu_times()
        return times.user + times.system
    except psutil.Error:
        return before


def main(words: Sequence[str] | None = None) -> int:
    """Send, watch, print; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live_load", description="Load a live run.")
    parser.add_argument("--sensors", type=int, default=10)
    parser.add_argument("--rate", type=float, default=10.0, help="readings a second of each sensor")
    parser.add_argument("--seconds", type=float, default=600.0, help="of the study")
    parser.add_argument("--speed", type=float, default=1.0, help="seconds of the study in one of the clock, 0: all")
    parser.add_argument("--sd", type=float, default=0.01, help="error of a reading")
    parser.add_argument("--experiment", default="live", help="the study")
    parser.add_argument("--most", type=float, default=2.0, help="the largest lag that is allowed, in cycles")
    parser.add_argument("--warm", type=int, default=0, help="first cycles whose lag does not count")
    parser.add_argument("words", nargs="*", help="further words of the run")
    asked = parser.parse_intermixed_args(words)
    with tempfile.TemporaryDirectory(prefix="dafw-load-") as name:
        place, port = Path(name), free_port()
        given = [f"experiment={asked.experiment}", *asked.words]
        cycles = round(asked.seconds / Sensors(given, 1).dt)
        given += [f"cycles={cycles}", "pictures=false"]
        sensors = Sensors(given, asked.sensors, asked.sd)
        live = ["readings=live", "readings.source=mqtt", f"readings.mqtt.port={port}", f"readings.patience={PATIENCE}"]
        command = [sys.executable, "-m", "dafw", "run", *given, *live, f"hydra.run.dir={place / 'run'}"]
        with broker(place, port) as server:
            link = Broker(BrokerOptions(port=port), "dafw/advice")
            watched = Watched(link, sensors.dt)
            with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as run:
                try:
                    sent = _send(asked, sensors, link, watched, run, server)
                    said = run.communicate(timeout=PATIENCE)[1]
                finally:
                    run.kill()
            link.close()
        if run.returncode != 0:
            print(said, file=sys.stderr)
            return 1
        summary = summary_of(place / "run")
    used = sum(summary["readings"].values())
    print(
        f"{sent} readings sent, {used} taken: {summary['readings']}; left out: {summary['readings_left_out'] or 'none'}"
    )
    found = np.array([one[1:] for one in watched.lags if one[0] >= asked.warm * sensors.dt])
    lags = {"by the clock": found[:, 0], "by the processor": found[:, 1]}
    if asked.speed == 0.0:
        del lags["by the clock"]
    for name, lag in lags.items():
        half, most = np.quantile(lag, [0.5, 0.99])
        print(
            f"lag {name}, in cycles, of {lag.size} beliefs: median {half:.2f}, 99 % {most:.2f}, at most {lag.max():.2f}"
        )
    return 0 if used == sent and max(lag.max() for lag in lags.values()) <= asked.most else 1


def _send(
    asked: argparse.Namespace,
    sensors: Sensors,
    link: Broker,
    watched: Watched,
    run: subprocess.Popen[str],
    server: subprocess.Popen[bytes],
) -> int:
    """Send what the sensors read, at its time, and print a row for every tenth of it; return how much was sent."""
    while watched.cycle < 0:
        if run.poll() is not None:
            raise SystemExit(f"live_load: the run has ended: {run.communicate()[1]}")
        watched.look(0.0, run.pid)
        time.sleep(0.02)
    row = "{:>8} {:>9} {:>18} {:>22} {:>9} {:>11}"
    print(row.format("t (s)", "readings", "lag by the clock", "lag by the processor", "run, MB", "broker, MB"))
    begun, sent, moment, shown = time.monotonic(), 0, 0.0, 0.0

    def now() -> float:
        return moment if asked.speed == 0.0 else min(asked.speed * (time.monotonic() - begun), asked.seconds)

    def show(until: float) -> None:
        clock, processor = watched.most(shown, until)
        lags = ("-" if asked.speed == 0.0 else f"{clock:.2f}", f"{processor:.2f}")
        print(row.format(f"{until:g}", sent, *lags, f"{resident(run.pid):.0f}", f"{resident(server.pid):.1f}"))
        sys.stdout.flush()

    for cycle in range(round(asked.seconds / sensors.dt)):
        sensors.step()
        while asked.speed == 0.0 and watched.cycle < cycle - 1 and not watched.ended:
            watched.look(moment, run.pid)
            time.sleep(0.002)
        if watched.ended or run.poll() is not None:
            raise SystemExit(f"live_load: the run has ended: {run.communicate()[1]}")
        for tick in range(max(1, round(sensors.dt * asked.rate))):
            moment = (cycle + (tick + 1) / max(1, round(sensors.dt * asked.rate))) * sensors.dt
            while now() < moment:
                watched.look(now(), run.pid)
                time.sleep(0.005)
            for message in sensors.read(moment):
                link.publish("dafw/readings", message)
                sent += 1
        link.publish("dafw/readings", json.dumps({"until": moment}).encode())
        watched.look(now(), run.pid)
        if moment - shown >= asked.seconds / 10 - 1e-9:
            show(moment)
            shown = moment
    link.publish("dafw/readings", b'{"end": true}')
    while run.poll() is None and not watched.ended:
        watched.look(asked.seconds, run.pid)
        time.sleep(0.02)
    return sent


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
