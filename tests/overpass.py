"""An Overpass server for tests, on this machine alone; it also misbehaves, as real ones and what stands before them do.

python tests/overpass.py [PORT]    serve until Ctrl-C, and print the address
"""

from __future__ import annotations

import json
import re
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Event
from urllib.parse import parse_qs, urlsplit

import numpy as np
from served import served

PLANT = Path(__file__).parents[1] / "dafw" / "plugins" / "models" / "dispersion" / "site" / "plant.geojson"
BUSY_PAGE = b"""<?xml version="1.0"?><html><head><title>OSM3S Response</title></head><body>
<p><strong style="color:#FF0000">Error</strong>: runtime error: The server is probably too busy to handle
your request.</p>
</body></html>"""


def way(number: int, corners, closed: bool = True, **tags: str) -> dict:
    """Return a way; the corners are longitude and latitude."""
    ring = [*corners, corners[0]] if closed else list(corners)
    geometry = [{"lat": float(lat), "lon": float(lon)} for lon, lat in ring]
    return {"type": "way", "id": number, "tags": tags, "geometry": geometry}


def relation(number: int, members: list[tuple[str, list]], **tags: str) -> dict:
    """Return a multipolygon; its members are roles with the places of their ways."""
    ways = [
        {"type": "way", "ref": k, "role": role, "geometry": [{"lat": float(y), "lon": float(x)} for x, y in line]}
        for k, (role, line) in enumerate(members)
    ]
    return {"type": "relation", "id": number, "tags": {"type": "multipolygon", **tags}, "members": ways}


def answer_of(elements: list) -> bytes:
    """Return a complete answer with these elements."""
    about = {"timestamp_osm_base": "2026-11-29T12:00:00Z", "copyright": "The data is made available under ODbL."}
    return json.dumps({"version": 0.6, "generator": "Overpass API", "osm3s": about, "elements": elements}).encode()


def plant_around(query: str) -> list:
    """Return the buildings of the shipped plant about the centre of the area that a query asks for."""
    south, west, north, east = map(float, re.findall(r"\(([-\d.e]+),([-\d.e]+),([-\d.e]+),([-\d.e]+)\)", query)[0])
    elements = []
    for number, feature in enumerate(json.loads(PLANT.read_text())["features"], start=1):
        shape, tags = feature["geometry"], feature["properties"]
        if shape["type"] == "Polygon" and ("building" in tags or "man_made" in tags):
            ring = np.array(shape["coordinates"][0])[:-1, :2] - [8.0, 50.0]
            ring[:, 0] *= np.cos(np.radians(50.0)) / np.cos(np.radians((south + north) / 2))
            places = ring + np.array([(west + east) / 2, (south + north) / 2])
            if ((places > [west, south]) & (places < [east, north])).all(axis=1).any():
                elements.append(way(number, np.round(places, 7).tolist(), **{k: str(v) for k, v in tags.items()}))
    return elements


class Standin(ThreadingHTTPServer):
    """Answers with the plant, or does in turn what is listed in ``tricks``; keeps what it was asked in ``asked``."""

    daemon_threads = True

    def __init__(self, port: int = 0) -> None:
        self.tricks: list[Callable[[Answers, str], None]] = []
        self.asked: list[tuple[str, dict[str, str]]] = []
        self.ended = Event()
        super().__init__(("127.0.0.1", port), Answers)

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/api/interpreter"

    def handle_error(self, request, client_address) -> None:
        """Say nothing of clients that hang up."""


class Answers(BaseHTTPRequestHandler):
    server: Standin
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        query = parse_qs(urlsplit(self.path).query).get("data", [""])[0]
        self.server.asked.append((query, dict(self.headers)))
        self.close_connection = True
        if self.server.tricks:
            return self.server.tricks.pop(0)(self, query)
        return self.send(answer_of(plant_around(query)))

    def send(self, content: bytes, status: int = 200, kind: str = "application/json", **headers: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        for name, value in {"Content_Length": str(len(content)), **headers}.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args) -> None:
        pass


def sends(content: bytes, status: int = 200, kind: str = "application/json", **headers: str):
    """Return a trick: an answer."""
    return lambda answers, query: answers.send(content, status, kind, **headers)


def busy(status: int = 429, **headers: str):
    """Return a trick: too busy, with the page that real servers send."""
    return sends(BUSY_PAGE, status, "text/html", **headers)


def cut_off(content: bytes, stated: int):
    """Return a trick: an answer that ends before the length that was stated."""
    return sends(content, Content_Length=str(stated))


def hang_up(answers: Answers, query: str) -> None:
    """A trick: the connection is closed without an answer."""
    answers.connection.close()


def babble(answers: Answers, query: str) -> None:
    """A trick: something that is not HTTP."""
    answers.wfile.write(b"\x00\x01SSH-2.0-OpenSSH\r\n\r\n")


def silence(answers: Answers, query: str) -> None:
    """A trick: nothing is said until the server ends."""
    answers.server.ended.wait()


def drip(answers: Answers, query: str) -> None:
    """A trick: an answer that comes byte by byte, without an end."""
    answers.send_response(200)
    answers.end_headers()
    while not answers.server.ended.wait(0.02):
        answers.wfile.write(b" ")


def endless(answers: Answers, query: str) -> None:
    """A trick: an answer that does not end."""
    answers.send_response(200)
    answers.end_headers()
    while True:
        answers.wfile.write(b" " * 2**20)


@contextmanager
def standing_in(port: int = 0) -> Iterator[Standin]:
    """Serve during the block."""
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)  # PETSc, if another test loaded it, has set it back
    with served(Standin(port)) as server:
        try:
            yield server
        finally:
            server.ended.set()


if __name__ == "__main__":
    with Standin(int(sys.argv[1]) if len(sys.argv) > 1 else 0) as alone:
        print(alone.address, flush=True)
        alone.serve_forever()
