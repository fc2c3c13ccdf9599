"""Serves the page on which release and drones are placed, to browsers on this machine."""

from __future__ import annotations

import signal
from math import isfinite
from urllib.parse import SplitResult, parse_qs

from dafw.views.local_server import LocalAnswers, LocalServer
from dafw.views.report_page import as_json, page
from dafw.views.site_page import answer_to, page_of_site
from dafw.views.site_places import Point
from dafw.views.site_preview import Preview

FAR = 1e6
"""Metres: no coordinate of a site is larger."""


class SiteServer(LocalServer):
    """Has the page at /, and at /command the command for places; ``chosen`` is the last one that was given.

    Raises ConfigurationError if the port cannot be used.
    """

    def __init__(self, preview: Preview, port: int = 0) -> None:
        self.preview = preview
        self.page = page(page_of_site(preview), "place", "place")
        self.chosen = preview.command(preview.free_places)
        super().__init__(_Answers, port, "site preview")


class _Answers(LocalAnswers):
    server: SiteServer

    def reply(self, asked: SplitResult) -> None:
        if asked.path == "/":
            return self.answer(200, "text/html", self.server.page)
        if asked.path != "/command":
            return self.answer(404, "text/plain", "There is nothing here.")
        preview = self.server.preview
        at = _points(parse_qs(asked.query).get("at", []))
        if at is None or len(at) != 1 + len(preview.places.drones):
            return self.answer(400, "text/plain", "expected a place x,y in metres for the release and every drone")
        found = answer_to(preview, at)
        # Another site's page could ask, though not read the answer; what it asked for is not what the user chose.
        if "command" in found and self.headers.get("Sec-Fetch-Site", "same-origin") == "same-origin":
            self.server.chosen = found["command"]
        return self.answer(200, "application/json", as_json(found))


def _points(words: list[str]) -> list[Point] | None:
    """Return places that are written as ``x,y``; None if one is not."""
    points = []
    for word in words:
        try:
            x, y = map(float, word.split(","))
        except ValueError:
            return None
        if not (isfinite(x) and isfinite(y) and max(abs(x), abs(y)) < FAR):
            return None
        points.append((x, y))
    return points


def serve(server: SiteServer) -> None:
    """Serve the page until Ctrl-C: print its address, and at the end the last command that it gave."""
    with server:
        # PETSc, with which the mesh was read, has let a browser that hangs up end this process.
        signal.signal(signal.SIGPIPE, signal.SIG_IGN)
        try:
            print(server.address, flush=True)  # who reads it may end the command at once
            server.serve_forever()
        except KeyboardInterrupt:
            print(server.chosen, flush=True)
