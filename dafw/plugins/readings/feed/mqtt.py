"""A broker of MQTT: messages come from a topic, and advice goes to another one.

The link may drop and come back: the broker keeps what is sent in the meantime for SESSION seconds, and paho connects
again by itself. A message is confirmed when it is in the inbox of the run: what comes before a kill is in its inbox, or
comes again. User name and password come from a file or from the environment, and are not part of any option.
"""

from __future__ import annotations

import logging
import os
import ssl
import sys
import threading
from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from dafw.core.errors import ConfigurationError, ReadingsError, RecordError
from dafw.core.options import option
from dafw.plugins.readings.feed.inbox import Inbox
from dafw.plugins.readings.feed.lines import Line, line_of
from dafw.plugins.readings.feed.messages import LONGEST

log = logging.getLogger("dafw")
USER, PASSWORD = "DAFW_MQTT_USER", "DAFW_MQTT_PASSWORD"
SESSION = 3600
"""Seconds for which a broker keeps messages for a client whose link has dropped."""
HELD = 64 << 20
"""Bytes of messages that wait to be read; those beyond are lost, and counted."""
OVERHEAD = 200
"""Bytes that a waiting line takes beside its text."""
FIRST = 10.0
"""Seconds that a run waits at its beginning for the broker, before it goes on and tries in the background."""
QUIET = 0.2
"""Seconds without a message after which all have come that a broker kept for a run that goes on."""
LAST = 60.0
"""Seconds that are given at the end to what is still to be sent."""
QUEUED = 100_000
"""Messages to send that wait for a broker that is away."""


@dataclass
class BrokerOptions:
    """A broker, and the topics of a run."""

    host: str = option("127.0.0.1", "name or address of the broker")
    port: int | None = option(None, "its port; null: 1883, with TLS 8883", minimum=1, maximum=65535)
    topic: str = option("dafw/readings", "topic of the messages; + and # stand for any, as MQTT has it")
    advice: str = option("dafw/advice", "topic of the advice")
    credentials: str | None = option(
        None,
        f"path of a file with the user's name in its first line and the password in its second; null: the variables "
        f"{USER} and {PASSWORD} of the environment, if they are set",
    )
    tls: bool = option(False, "whether the link is encrypted, and the broker's certificate checked")
    ca: str | None = option(None, "path of the certificate of the authority that vouches for it; null: the system's")


def require_broker(options: BrokerOptions, label: str) -> None:
    """Raise ConfigurationError if paho is not installed, or the options cannot be those of a broker."""
    if find_spec("paho") is None:
        raise ConfigurationError(f"{label}: a broker needs paho-mqtt: pip install 'dafw[live]'")
    if "@" in options.host or "/" in options.host:
        raise ConfigurationError(
            f"{label}: mqtt.host must be a name or an address alone; user and password come from a file or the "
            "environment"
        )
    if "#" in options.advice or "+" in options.advice:
        raise ConfigurationError(f"{label}: mqtt.advice must be one topic, got {options.advice!r}")
    if options.ca is not None and not options.tls:
        raise ConfigurationError(f"{label}: mqtt.ca goes with mqtt.tls=true")
    for path in (options.ca, options.credentials):
        if path is not None and not Path(path).expanduser().is_file():
            raise ConfigurationError(f"{label}: there is no file {path}")


def credentials_of(options: BrokerOptions) -> tuple[str, str | None] | None:
    """Return the user's name and password; None if there are none. Raises ReadingsError that does not show them."""
    if options.credentials is None:
        user = os.environ.get(USER)
        return None if not user else (user, os.environ.get(PASSWORD))
    try:
        lines = Path(options.credentials).expanduser().read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        raise ReadingsError(f"mqtt.credentials: {options.credentials} cannot be read") from None
    if not lines or not lines[0].strip():
        raise ReadingsError(f"mqtt.credentials: {options.credentials} must have the user's name in its first line")
    return lines[0].strip(), lines[1] if len(lines) > 1 else None


class Broker:
    """A link to a broker that hears one topic, or None: it only sends; a channel of a feed.

    ``client`` is the name by which the broker knows the link, by default a new one. ``goes_on``: it had this name
    before, and takes what the broker kept for it; ``kept`` then says whether the broker remembered it. With an
    ``inbox`` messages are confirmed when they are in it, and ``offset`` is where in it the lines end that were asked
    for; each must be in the journal when the next one is asked for. Without, they are confirmed as they come.
    """

    ended = False

    def __init__(
        self,
        options: BrokerOptions,
        topic: str | None,
        client: str = "",
        *,
        goes_on: bool = False,
        inbox: Inbox | None = None,
    ) -> None:
        self._options, self._topic, self._inbox = options, topic, inbox
        self._name, self._goes_on, self.kept = client or f"dafw-{os.urandom(8).hex()}", goes_on, False
        self._lines: deque[Line] = deque()
        self._held = self._lost = self.offset = 0
        self._unwritable: RecordError | None = None
        if inbox is not None:
            self._hold(inbox.waiting)
        self._changed = threading.Condition()
        self._heard = threading.Event()  # the topic is subscribed, or the link there if there is no topic
        self._refused = ""
        self._last: Any = None
        self._place = f"{options.host}:{self._port}"
        self._client = self._made()
        self._connect()

    @property
    def _port(self) -> int:
        return self._options.port or (8883 if self._options.tls else 1883)

    def _made(self) -> Any:
        from paho.mqtt.client import Client, MQTTv5
        from paho.mqtt.enums import CallbackAPIVersion

        client = Client(CallbackAPIVersion.VERSION2, client_id=self._name, protocol=MQTTv5)
        found = credentials_of(self._options)
        if found is not None:
            client.username_pw_set(*found)
        if self._options.tls:
            ca = self._options.ca
            try:
                trusted = ssl.create_default_context(cafile=None if ca is None else str(Path(ca).expanduser()))
            except OSError:
                raise ReadingsError(f"mqtt.ca: {ca} is no certificate that can be read") from None
            client.tls_set_context(trusted)
        client.manual_ack_set(self._inbox is not None)
        client.reconnect_delay_set(1, 30)
        client.max_queued_messages_set(QUEUED)
        client.on_connect, client.on_message = self._on_connect, self._on_message
        client.on_subscribe, client.on_disconnect = self._on_subscribe, self._on_disconnect
        return client

    def _connect(self) -> None:
        """Connect, and wait a while until the topic is heard; a broker that is away is tried on and on."""
        from paho.mqtt.client import MQTT_CLEAN_START_FIRST_ONLY
        from paho.mqtt.packettypes import PacketTypes
        from paho.mqtt.properties import Properties

        keep = Properties(PacketTypes.CONNECT)
        keep.SessionExpiryInterval = SESSION
        clean = False if self._goes_on else MQTT_CLEAN_START_FIRST_ONLY
        how = {"keepalive": 30, "clean_start": clean, "properties": keep}
        try:
            self._client.connect(self._options.host, self._port, **how)
        except ssl.SSLError as error:
            raise ReadingsError(f"the broker at {self._place} cannot be trusted ({error.reason or error})") from None
        except OSError as error:
            self._warn(f"the broker at {self._place} cannot be reached ({error.strerror or error}); trying on")
            self._client.connect_async(self._options.host, self._port, **how)
        self._client.loop_start()
        deadline = monotonic() + FIRST
        while not self._heard.wait(0.05) and monotonic() < deadline:
            self._require_welcome()
        self._require_welcome()
        if self.kept and self._goes_on:
            before = -1
            while (found := len(self._lines)) != before and monotonic() < deadline:
                before = found
                sleep(QUIET)

    def _require_welcome(self) -> None:
        if self._refused:
            self._client.loop_stop()
            raise ReadingsError(f"the broker at {self._place} refuses the link ({self._refused})")

    @staticmethod
    def _warn(text: str) -> None:
        log.warning("%s", text)
        print(f"dafw: warning: {text}", file=sys.stderr)

    def _on_connect(self, client: Any, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure:
            self._refused = str(reason)
            return
        self.kept = self.kept or bool(flags.session_present)
        if self._topic is None:
            self._heard.set()
        else:
            client.subscribe(self._topic, qos=1)  # anew, because a broker that was started again has forgotten it

    def _on_subscribe(self, client: Any, data: Any, number: int, reasons: Any, properties: Any) -> None:
        if any(reason.is_failure for reason in reasons):
            self._refused = f"{self._topic}: {reasons[0]}"
        self._heard.set()

    def _on_disconnect(self, client: Any, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure and not self._refused:
            log.warning("the link to the broker at %s dropped (%s); trying on", self._place, reason)

    def _on_message(self, client: Any, data: Any, message: Any) -> None:
        parts = [part for part in message.payload.splitlines() if part.strip()]
        with self._changed:
            if message.dup and self._inbox is not None and self._inbox.had(parts, message.mid):
                parts = []  # sent again, because the broker was not told of the receipt
            room = self._held + sum(map(_size_of, parts)) <= HELD
            if not room:
                self._lost += len(parts)
            elif self._inbox is None:
                self._hold(map(line_of, parts))
            elif self._unwritable is None:
                try:
                    self._hold(self._inbox.put(parts, message.mid))
                except RecordError as error:
                    self._unwritable = error
            self._changed.notify()
        if self._unwritable is None:  # else it comes again when the run goes on
            client.ack(message.mid, message.qos)

    def _hold(self, lines: Iterable[Line]) -> None:
        for line in lines:
            self._lines.append(line)
            self._held += len(line.text) + OVERHEAD

    def next(self, seconds: float) -> Line | None:
        """Return the next line; None if none came in time.

        Raises ReadingsError if the broker refuses the link, RecordError if the inbox cannot be written.
        """
        with self._changed:
            if self._inbox is not None and not self._lines:
                self._inbox.all_taken()
            if not self._lines and seconds > 0.0:
                self._changed.wait(seconds)
            if self._unwritable is not None:
                raise self._unwritable
            if self._lines:
                line = self._lines.popleft()
                self._held -= len(line.text) + OVERHEAD
                self.offset = line.end
                return line
            lost, self._lost = self._lost, 0
        self._require_welcome()
        return Line(left_out="lost", count=lost) if lost else None

    def publish(self, topic: str, line: bytes, *, keep: bool = False) -> None:
        """Send a line; ``keep``: the broker keeps it for those who come later. Raises OSError if too many wait."""
        from paho.mqtt.enums import MQTTErrorCode

        sent = self._client.publish(topic, line.strip(), qos=1, retain=keep)
        if sent.rc == MQTTErrorCode.MQTT_ERR_QUEUE_SIZE:
            raise OSError(f"{QUEUED} messages wait for the broker at {self._place}")
        self._last = sent

    def close(self) -> None:
        """Wait until everything is sent, and leave."""
        if self._last is not None and self._client.is_connected():
            with suppress(RuntimeError, ValueError):  # it was sent while the link was down
                self._last.wait_for_publish(timeout=LAST)
        self._client.disconnect()
        self._client.loop_stop()
        if self._inbox is not None:
            self._inbox.close(empty=not self._lines)


def _size_of(part: bytes) -> int:
    """Return how many bytes a line takes while it waits."""
    return OVERHEAD + (len(part) if len(part) <= LONGEST else 0)
