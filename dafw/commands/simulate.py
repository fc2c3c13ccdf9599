"""``dafw simulate``: a truth and a drone that obeys the advice of a live run, in a process of its own."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dafw.commands.parser import Parser
from dafw.core.errors import ComputationError, ConfigurationError

PLACE = "hydra.run.dir="


def simulate_command(words: Sequence[str]) -> int:
    """Play the other side of a live run; raises DafwError."""
    parser = Parser(
        prog="dafw simulate",
        description="Play the truth of a study, and vehicles that obey the advice of the live run that is given the "
        "same words: dafw simulate WORDS | dafw run WORDS, with readings=live and hydra.run.dir=DIR among them.",
    )
    parser.add_argument("overrides", nargs="*", help="the words of the run")
    parser.add_argument("--config-dir", metavar="DIR", help="a folder with further configuration, as for dafw run")
    parser.add_argument("--patience", type=float, default=600.0, help="seconds without advice after which it gives up")
    asked = parser.parse_intermixed_args(words)
    from dafw.core.composition import compose, study_part
    from dafw.core.experiment import study_from
    from dafw.core.registry import registry
    from dafw.plugins.readings.live import Live
    from dafw.studies.advice import FILE as ADVICE
    from dafw.studies.simulating import Simulation, line_of
    from dafw.studies.truth_file import FILE, TruthFile

    if not any(word.startswith(PLACE) for word in asked.overrides):
        raise ConfigurationError(f"simulate: give both commands the same {PLACE}DIR, in which the advice appears")
    config = compose(asked.overrides, Path(asked.config_dir).resolve() if asked.config_dir else None)
    folder = Path(config.hydra.run.dir).resolve()
    composed = study_part(config)
    live = registry().create("readings", composed["readings"])
    if not isinstance(live, Live):
        raise ConfigurationError(f"simulate plays the feed of readings=live, got readings={live.name}")
    path = folder / FILE
    if path.exists() or (live.clock == "feed" and _is_under_way(folder / ADVICE)):
        raise ConfigurationError(f"simulate: {folder} holds a truth or a run already; nothing was changed")
    study = study_from({**composed, "readings": {"name": "twin"}})
    parts, vehicle = study.prepare()
    attributes = {"title": f"truth of the dafw study {study.name}", "name": study.name, "seed": study.seed}
    link = _link(live, folder)
    truth = TruthFile(path, parts.model.space, attributes)
    simulation = Simulation(
        parts,
        vehicle,
        live,
        study.cycles,
        lambda message: link.send(line_of(message)),
        link.advice,
        truth,
        asked.patience,
        link.is_heard,
    )
    try:
        done = simulation.play()
        said = f"{done} cycles, {simulation.readings} readings"
    except BrokenPipeError:
        _leave_standard_output()
        said = f"nobody reads the feed any more, after {simulation.readings} readings"
    finally:
        link.close()
        truth.close()
        if not simulation.begun:
            path.unlink()  # the run has never begun: the same words can be tried again
    if not simulation.begun:
        raise ComputationError("simulate: the run ended before its first advice")
    print(f"dafw simulate: {said}; the truth is in {path}", file=sys.stderr)
    return 0


def _is_under_way(advice: Path) -> bool:
    """Return whether a run has gone beyond its first advice, for which it needs no simulation."""
    try:
        with advice.open("rb") as stream:
            return sum(1 for _ in stream) > 1
    except FileNotFoundError:
        return False


@dataclass(frozen=True)
class _Link:
    """What sends a line, what brings advice, what says whether anybody listens, and what closes it."""

    send: Callable[[bytes], None]
    advice: Any
    is_heard: Callable[[], bool] = lambda: True
    close: Callable[[], None] = lambda: None


def _link(live: Any, folder: Path) -> _Link:
    """Return the other side of what ``readings=live`` reads."""
    from dafw.plugins.readings.feed.channels import GrowingFile
    from dafw.plugins.readings.feed.mqtt import Broker, require_broker
    from dafw.plugins.readings.feed.options import EXAMPLE, MQTT
    from dafw.studies.advice import FILE
    from dafw.studies.simulating import Advised

    if live.source == MQTT:
        require_broker(live.mqtt, live.label)
        if "#" in live.mqtt.topic or "+" in live.mqtt.topic:
            raise ConfigurationError(f"simulate: mqtt.topic must be one topic, got {live.mqtt.topic!r}")
        broker = Broker(live.mqtt, live.mqtt.advice)
        return _Link(lambda line: broker.publish(live.mqtt.topic, line), Advised(broker), close=broker.close)
    advice = Advised(GrowingFile(folder / FILE))
    if live.source == "-":
        poll = select.poll()
        poll.register(1, select.POLLERR)

        def to_standard_output(line: bytes) -> None:
            sys.stdout.buffer.write(line)
            sys.stdout.buffer.flush()

        return _Link(to_standard_output, advice, lambda: not poll.poll(0))
    if live.source == EXAMPLE:
        raise ConfigurationError("simulate: readings.source must be -, mqtt or the path of a file, got example")
    file = Path(live.source).expanduser()

    def to_file(line: bytes) -> None:
        with file.open("ab") as stream:
            stream.write(line)

    return _Link(to_file, advice)


def _leave_standard_output() -> None:
    """Keep Python from writing what is left to a pipe that nobody reads."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
