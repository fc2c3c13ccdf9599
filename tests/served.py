"""A server that runs during a block, in a thread of the test, and what it answers."""

from __future__ import annotations

import http.client
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import HTTPServer
from threading import Thread

from waiting import PATIENCE


@contextmanager
def served[Server: HTTPServer](server: Server) -> Iterator[Server]:
    """Serve during the block; the server is closed afterwards."""
    with server:
        thread = Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


def ask(server: HTTPServer, path: str, **headers: str) -> tuple[int, str]:
    """Return status and text of an answer; ``Sec_Fetch_Site`` stands for the header ``Sec-Fetch-Site``."""
    connection = http.client.HTTPConnection(*server.server_address, timeout=PATIENCE)
    connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text
