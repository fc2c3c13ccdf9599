"""Readings that come while the run goes on: lines of JSON from standard input, a file that grows, or a broker.

docs/live.md describes the messages. In every cycle the source waits for readings. The cycle is over when the clock says
so: the ``wall``'s, when its time has come; the ``feed``'s, when a reading of a later cycle has come, or a message that
says that all readings up to its end have been sent. Garbage never stops a run, it is counted. All lines go to the
journal of the run.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from time import time
from typing import Any, Self

import numpy as np

from dafw.core.domain import Domain
from dafw.core.ensemble import Memory
from dafw.core.errors import ConfigurationError, NoMoreReadingsError
from dafw.core.interfaces import Readings
from dafw.core.interfaces.readings import Request, Taken
from dafw.core.observation import Observation
from dafw.core.options import build
from dafw.core.space import StateSpace
from dafw.plugins.observers.path import ends_of, line_means
from dafw.plugins.readings.feed import inbox as inbox_file
from dafw.plugins.readings.feed.channels import Channel, Pipe, channel_to
from dafw.plugins.readings.feed.collecting import Patience, collect
from dafw.plugins.readings.feed.desk import Desk, Rules
from dafw.plugins.readings.feed.feed import Feed, Replayed
from dafw.plugins.readings.feed.inbox import Inbox
from dafw.plugins.readings.feed.journal import FILE, head_of, reached
from dafw.plugins.readings.feed.mqtt import Broker, require_broker
from dafw.plugins.readings.feed.options import EXAMPLE, MQTT, FeedOptions
from dafw.plugins.readings.feed.rehearsal import rehearsed
from dafw.plugins.readings.feed.rules import rules_of
from dafw.plugins.readings.feed.state import FeedState, Reading
from dafw.plugins.readings.feed.usable import observations_of, vehicles_of
from dafw.plugins.readings.files.placing import require_origin
from dafw.plugins.readings.files.sensors import ErrorOptions
from dafw.plugins.readings.files.times import parsed_date
from dafw.plugins.readings.files.units import linear

STANDARD_INPUT = ("/dev/stdin", "/dev/fd/0", "/proc/self/fd/0")
"""Other names of standard input."""


@dataclass
class Live(FeedOptions, Readings):
    """Readings from a feed."""

    is_live = True
    journal = FILE
    word = "message"

    _feed: Feed | None = field(default=None, init=False, repr=False, compare=False)
    _folder: Path | None = field(default=None, init=False, repr=False, compare=False)
    _broker: Broker | None = field(default=None, init=False, repr=False, compare=False)
    _pipe: Channel | None = field(default=None, init=False, repr=False, compare=False)
    _client: str = field(default="", init=False, repr=False, compare=False)
    _known: int = field(default=0, init=False, repr=False, compare=False)

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return the messages that ship with dafw."""
        return {"source": EXAMPLE}

    def __post_init__(self) -> None:
        require_origin(self.origin, "readings 'live'")
        if self.entries and self.paths:
            raise ConfigurationError("readings 'live': sensors have entries or paths, not both")
        if self.clock == "wall" and self.start == "first":
            raise ConfigurationError("readings 'live': start=first goes with clock=feed")
        if isinstance(self.start, str) and self.start != "first" and parsed_date(self.start, None) is None:
            raise ConfigurationError(
                f"readings 'live': start must be seconds, a date in ISO 8601, or first, got {self.start!r}"
            )
        if len(set(self.vehicles)) < len(self.vehicles):
            raise ConfigurationError(f"readings 'live': vehicles must be different sensors, got {self.vehicles}")
        self._paths = ends_of(self.paths, "readings 'live'")
        common = {one.name: getattr(self, one.name) for one in fields(ErrorOptions)}
        self._errors = {}
        for name, own in self.sensors.items():
            where = f"readings 'live', sensor '{name}'"
            if not isinstance(own, Mapping):
                raise ConfigurationError(f"{where}: expected a mapping of options, got {own!r}")
            self._errors[name] = build(ErrorOptions, common | dict(own), where)
        self._common = ErrorOptions(**common)
        self._asked: Callable[[], bool] = lambda: False

    def suit(self, space: StateSpace, domain: Domain | None, dt: float) -> None:
        """Raise ConfigurationError for units, entries or paths that do not fit the variable."""
        if self.source == MQTT:
            require_broker(self.mqtt, self.label)
        variable = space.variables[0] if self.variable is None else space[self.variable]
        linear(self.unit or variable.units, self.reference or variable.units)
        for name, entry in self.entries.items():
            if entry >= variable.size:
                raise ConfigurationError(
                    f"{self.label}: sensor '{name}' reads entry {entry}, '{variable.name}' has {variable.size}"
                )
        if self._paths:
            line_means(variable, list(self._paths.values()), self.label)
        self._rules(space, domain)

    def _origin(self, domain: Domain | None) -> tuple[float, float] | None:
        if self.origin is not None:
            return float(self.origin[0]), float(self.origin[1])
        return None if domain is None else domain.origin

    def _rules(self, space: StateSpace, domain: Domain | None) -> Rules:
        return rules_of(self, space, self._origin(domain) is not None, self._errors, self._common)

    def begin(self, folder: Path, asked_to_stop: Callable[[], bool]) -> None:
        """Keep the folder of the journal, and begin to read what cannot be read again."""
        self._folder, self._asked = folder, asked_to_stop
        self.__dict__.pop("_zero", None)  # of a run before
        before, path = head_of(folder / FILE), folder / inbox_file.FILE
        self._known, taken = reached(folder / FILE)
        heads = [before, inbox_file.head_of(path) if self.source == MQTT else None]
        names = [one.client for one in heads if one is not None and one.client]
        self._client = names[0] if names else f"dafw-{os.urandom(8).hex()}"
        if self.clock == "wall":
            linear("ppm", "ppb")  # units are loaded now, not when the first message with one has come
        if self.source == "-":
            self._pipe = Pipe(0)
        elif self.source == MQTT:
            inbox = Inbox(path, taken, self._client)
            self._broker = Broker(self.mqtt, self.mqtt.topic, self._client, goes_on=bool(names), inbox=inbox)
        if before is not None:
            print(f"dafw: {self._goes_on()}", file=sys.stderr)

    def _goes_on(self) -> str:
        """Return where the readings of a run that goes on come from, and what is lost."""
        if self.source == MQTT:
            kept = "what the broker kept" if self._connected_broker().kept else "the broker, which has kept nothing"
        elif self._is_pipe:
            kept = f"{self._place} as it is now; what was sent in between is lost"
        else:
            kept = f"{self._place}, from where it was read to"
        return f"cycles in {FILE}: {self._known}; then readings come from {kept}"

    @property
    def _is_pipe(self) -> bool:
        return self.source == "-" or Path(self.source).expanduser().is_fifo()

    @property
    def _place(self) -> str:
        return "standard input" if self.source == "-" else self.source

    def known_cycles(self) -> int:
        """Return how many first cycles the journal has all readings of."""
        return self._known

    def settle(self) -> None:
        """Write the journal to the disk."""
        if self._feed is not None:
            self._feed.settle()

    def again(self, folder: Path) -> Self:
        """Return the source of a run that is given what is in the journal of the run in ``folder``."""
        return replace(self, source=str(folder / FILE))

    @property
    def follows_wall(self) -> bool:  # type: ignore[override]  # it depends on the options
        """Whether cycles end by the wall's clock."""
        return self.clock == "wall"

    @property
    def reads_standard_input(self) -> bool:  # type: ignore[override]  # it depends on the options
        """Whether the messages come from standard input."""
        return self.source in ("-", *STANDARD_INPUT)

    def _connected_broker(self) -> Broker:
        """Return the link to the broker, which is made once; here it is one without an inbox."""
        if self._broker is None:
            self._broker = Broker(self.mqtt, self.mqtt.topic if self.source == MQTT else None, self._client)
        return self._broker

    @property
    def advises(self) -> Sequence[str]:
        """Where advice goes beside the places that a study names: back to where the readings come from."""
        return [MQTT] if self.source == MQTT else []

    def publisher(self) -> Callable[[bytes], None]:
        """Return what sends a line of advice to the broker; raises ConfigurationError, ReadingsError."""
        require_broker(self.mqtt, self.label)
        broker, topic = self._connected_broker(), self.mqtt.advice
        return lambda line: broker.publish(topic, line, keep=True)

    def end(self) -> None:
        """Close the feed and the journal."""
        if self._feed is not None:
            self._feed.close()
        if self._broker is not None:
            self._broker.close()
        self._feed = self._folder = self._pipe = self._broker = None

    def _connected(self, state: FeedState) -> Channel:
        if self._pipe is not None:
            return self._pipe
        if self.source == MQTT:
            return self._connected_broker()
        if self.source == EXAMPLE:
            return channel_to(str(Path(__file__).with_name("feed") / "example.jsonl"), state.offset)
        path = Path(self.source).expanduser()
        return Replayed(path, state.entries) if head_of(path) else channel_to(self.source, state.offset)

    def _opened(self, state: FeedState, cycle: int) -> Feed:
        """Return the feed, opened where ``state`` says; in the first cycle, note what is t = 0."""
        if self._feed is None:
            if cycle == 0:
                self._set_zero(state)
            self._feed = Feed(self._connected, state, self._folder, state.zero, self._client)
        return self._feed

    @cached_property
    def _zero(self) -> float | None:
        """The Unix time of t = 0, as far as it is known before the first message."""
        moment = parsed_date(self.start, None) if isinstance(self.start, str) else None
        if moment is not None or self.clock == "feed":
            return None if moment is None else moment.timestamp()
        own = None if self._folder is None else self._folder / FILE
        before = head_of(own) if own is not None else None
        if before is None and self.source not in ("-", MQTT):
            before = head_of(Path(self.source).expanduser())
        return time() if before is None else before.zero

    def _set_zero(self, state: FeedState) -> None:
        state.zero = self._zero
        if isinstance(self.start, str):
            state.seconds = None if self.start == "first" else 0.0
        else:
            state.seconds = 0.0 if self.start is None else float(self.start)

    def take_with_memory(self, request: Request, memory: Memory | None, rng: np.random.Generator) -> Taken:
        """Wait for the readings of the cycle and return them; raises NoMoreReadingsError where the feed has ended."""
        state = FeedState.of(memory)
        feed = self._opened(state, request.cycle)
        rules = self._rules(request.space, request.domain)
        origin = self._origin(request.domain)
        desk = Desk(rules, state, request.end, request.end - request.start)
        wall = self.clock == "wall"
        collect(feed, desk, request.cycle, self.grace, Patience(wall, self.patience, self._asked))
        if desk.state.ended and desk.is_barren:
            raise NoMoreReadingsError(f"{self.label}: the feed has ended")
        observations, unplaced = self._observations(desk.due, rules, request)
        vehicles, impossible = vehicles_of(desk.due, rules, state, request.domain, origin)
        left_out = {**desk.left_out, **unplaced} | ({"vehicle_in_wall_or_outside": impossible} if impossible else {})
        return Taken(observations, state.memory(), tuple(desk.notes), left_out, vehicles)

    def rehearsal(self, request: Request) -> Sequence[Observation]:
        """Return readings of a truth that are placed as messages are."""
        if request.truth is None:
            return ()
        space, rules = request.space, self._rules(request.space, request.domain)
        named = space.variables[0] if self.variable is None else space[self.variable]
        members, paths = request.truth.members, self._paths or None
        readings = rehearsed(members, rules, named, request.end, entries=space.slice(named.name), paths=paths)
        return self._observations(readings, rules, request)[0]

    def _observations(
        self, readings: Sequence[Reading], rules: Rules, request: Request
    ) -> tuple[list[Observation], dict[str, int]]:
        """Return readings as observations, and how many had no place here, by reason."""
        return observations_of(
            readings,
            rules,
            request.space,
            request.domain,
            request.end,
            variable=self.variable,
            origin=self._origin(request.domain),
            paths=self._paths or None,
        )

    def zero_of_run(self, memory: Memory | None) -> float | None:
        """Return the Unix time of t = 0; None where it is not known."""
        return self._zero if memory is None else FeedState.of(memory).zero

    def notes(self) -> list[str]:
        """Return where the readings come from, in one sentence."""
        told = [f"{self.label}: readings come from {self._place}; a cycle ends by the clock of the {self.clock}"]
        return [*told, self._goes_on()] if self._known else told
