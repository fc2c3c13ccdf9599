"""A server for browsers on this machine alone; the pages that it serves ask nobody else."""

from __future__ import annotations

import sys
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import SplitResult, urlsplit

from dafw.core.errors import ConfigurationError

HOST = "127.0.0.1"


class LocalServer(ThreadingHTTPServer):
    """Listens at a port of 127.0.0.1; raises ConfigurationError, which names the command, if the port cannot be used.

    Port 0 is one that is free.
    """

    daemon_threads = True

    def __init__(self, answers: type[LocalAnswers], port: int, command: str) -> None:
        try:
            super().__init__((HOST, port), answers)
        except (OSError, OverflowError) as error:
            raise ConfigurationError(f"{command}: port {port} cannot be used ({error})") from error

    @property
    def address(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self.server_address[1]}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a browser that went away in the middle of an answer; report anything else."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class LocalAnswers(BaseHTTPRequestHandler):
    """Answers requests that name this machine; a subclass defines ``reply``."""

    server: LocalServer

    def do_GET(self) -> None:
        """Refuse a request that names another machine; let the subclass answer all others."""
        # A page of elsewhere could reach this server under a name of its own.
        if self.headers.get("Host", "") not in {f"{name}:{self.server.server_port}" for name in (HOST, "localhost")}:
            return self.answer(403, "text/plain", "This server answers to its own address only.")
        return self.reply(urlsplit(self.path))

    def reply(self, asked: SplitResult) -> None:
        """Answer a request for an address."""
        raise NotImplementedError

    def answer(self, status: int, kind: str, text: str) -> None:
        """Send an answer of a kind such as ``text/html``."""
        content = text.encode("utf-8")
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        if status != 204:
            self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing for each request."""
