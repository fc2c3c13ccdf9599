"""The options that say where a feed comes from and how its messages are to be understood."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from dafw.core.options import option
from dafw.plugins.readings.feed.mqtt import BrokerOptions
from dafw.plugins.readings.files.options import ColumnOptions
from dafw.plugins.readings.files.sensors import ErrorOptions

EXAMPLE, MQTT = "example", "mqtt"
"""Sources that are no paths, beside - for standard input."""
CLOCKS = ("feed", "wall")


@dataclass
class FeedOptions(ErrorOptions):
    """A feed, and the errors of its sensors."""

    source: str = option(
        "-",
        "standard input (-), a broker (mqtt), the path of a file that grows, of a named pipe or of the "
        "journal.jsonl of a run, or 'example' for a few messages that ship with dafw",
    )
    mqtt: BrokerOptions = option(BrokerOptions, "the broker, for source=mqtt and advice=mqtt")
    clock: str = option(
        "feed",
        "when a cycle ends: at its time by the wall's clock, or when the feed has come to a later time",
        choices=CLOCKS,
    )
    start: float | str | None = option(
        None,
        "what is t = 0: a time as in the messages (s, or a date), or first: that of the first message. null: 0 s; for "
        "dates the first message, or by the wall's clock the beginning of the run",
    )
    grace: float = option(0.0, "seconds that a cycle waits for its readings after its end", minimum=0.0)
    furthest: float = option(
        3600.0, "a message that is so many seconds after the end of the cycle or more is not believed", above=0.0
    )
    most: int = option(10000, "readings that a cycle may have, and those of later ones that may wait", minimum=1)
    patience: float | None = option(
        None, "seconds without any message after which the feed has ended; null: the run waits", above=0.0
    )
    columns: ColumnOptions = option(ColumnOptions, "by which keys the messages have what")
    time_format: str | None = option(
        None, "how times are written, as in Python's strptime; a * at the end: anything may follow. null: ISO 8601"
    )
    origin: list[float] | None = option(None, "[lon, lat] of the plane's (0, 0) in degrees; null: the site's")
    variable: str | None = option(None, "state variable that is read; null: the first")
    unit: str | None = option(None, "unit of the values; null: what the messages say, else that of the variable")
    reference: str | None = option(None, "what 1 of the variable stands for, such as '250 mg m-3'; null: its own unit")
    lowest: float | None = option(None, "values below it, as they are told, cannot be and are left out")
    highest: float | None = option(None, "values above it cannot be and are left out")
    vehicles: list[str] = option(
        [], "the sensors on the vehicles, in the vehicles' order; none: those called 'drone 0', 'drone 1', ..."
    )
    entries: dict[str, int] = option({}, "by sensor: the entry of the variable that it reads, from 0", minimum=0)
    paths: dict[str, Any] = option(
        {}, "by sensor: the line along which it reads the mean of the variable, [[x, y], [x, y]] in metres"
    )
    sensors: dict[str, Any] = option(
        {}, "by sensor: a mapping with its own sd, relative_sd, background, detection_limit"
    )
