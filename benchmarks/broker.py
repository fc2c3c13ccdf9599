"""A broker, mosquitto, that this machine alone can reach: for load, and for the tests of live readings."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
"""The program; None if it is not installed."""
PATIENCE = 60.0
"""Seconds in which a broker must answer."""


def free_port() -> int:
    """Return a port of the loopback device that nobody uses."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@contextmanager
def broker(folder: Path, port: int, *lines: str) -> Iterator[subprocess.Popen[bytes]]:
    """Start a broker on the loopback device, and end it with the block.

    ``lines`` are more settings, instead of letting everybody in. Raises SystemExit if there is no mosquitto or it does
    not answer.
    """
    if MOSQUITTO is None:
        raise SystemExit("there is no broker: mosquitto is not installed")
    settings = folder / "broker.conf"
    text = [f"listener {port} 127.0.0.1", *(lines or ["allow_anonymous true"]), "set_tcp_nodelay true"]
    text += ["user root"] if os.geteuid() == 0 else []  # who could not read the files of a test otherwise
    settings.write_text("\n".join(text) + "\n")
    with subprocess.Popen([MOSQUITTO, "-c", settings], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            deadline = time.monotonic() + PATIENCE
            while True:
                with socket.socket() as one:
                    if one.connect_ex(("127.0.0.1", port)) == 0:
                        break
                if process.poll() is not None or time.monotonic() > deadline:
                    raise SystemExit(f"the broker does not answer at port {port} (exit status {process.poll()})")
                time.sleep(0.02)
            yield process
        finally:
            process.terminate()
