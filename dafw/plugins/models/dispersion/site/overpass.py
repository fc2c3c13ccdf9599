"""Asking an Overpass server (a search engine for OpenStreetMap) politely, and giving up with one clear line.

The protocol: https://wiki.openstreetmap.org/wiki/Overpass_API. A server that is busy says 429 or 504, and may say in
``Retry-After`` when to come back (RFC 9110, 10.2.3). It is then asked again, a few times, after longer and longer
pauses. Whatever else is wrong is not asked again.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from http.client import HTTPException, IncompleteRead
from importlib.metadata import version
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import urlencode, urlsplit
from urllib.request import Request, urlopen

from dafw.core.errors import ConfigurationError, FetchError
from dafw.plugins.models.dispersion.site.area import Area
from dafw.plugins.models.dispersion.site.geojson import MAN_MADE
from dafw.plugins.models.dispersion.site.osm_pages import words_of_page

PUBLIC_SERVER = "https://overpass-api.de/api/interpreter"
"""The server that the project itself runs."""
PAUSES = (5.0, 15.0, 45.0)
"""Seconds between tries, where the server does not say how long."""
LONGEST_PAUSE = 300.0
"""Seconds: whoever is asked to wait longer is told so, and nothing waits."""
LARGEST = 64 * 2**20
"""Bytes of an answer; more would be a hundred thousand buildings."""
CHUNK = 2**16


class _LaterError(Exception):
    """The server may answer if it is asked again; ``wait`` is after how many seconds, if it said so."""

    def __init__(self, reason: str, wait: float | None = None) -> None:
        super().__init__(reason)
        self.wait = wait


def query_of(area: Area, timeout: float) -> str:
    """Return the question, in Overpass QL, for all buildings that touch an area, with their coordinates."""
    box = f"({area.south},{area.west},{area.north},{area.east})"
    man_made = "|".join(sorted(MAN_MADE))
    wanted = [
        f"{kind}{tag}{box};"
        for kind in ("way", "relation")
        for tag in ('["building"]["building"!="no"]', f'["man_made"~"^({man_made})$"]')
    ]
    return f"[out:json][timeout:{max(1, round(timeout))}][maxsize:{4 * LARGEST}];({''.join(wanted)});out geom;"


def require_server(address: str) -> None:
    """Raise ConfigurationError unless an address can be one of an Overpass server."""
    try:
        parts = urlsplit(address)
        usable = parts.scheme in ("http", "https") and bool(parts.hostname) and not (parts.query or parts.fragment)
        usable = usable and parts.port != 0 and "@" not in parts.netloc and address.isascii() and " " not in address
    except ValueError:
        usable = False
    if not usable:
        raise ConfigurationError(
            f"site fetch: expected the address of a server, such as {PUBLIC_SERVER}, got {address!r}"
        )


def ask(
    server: str,
    query: str,
    timeout: float,
    *,
    say: Callable[[str], None],
    sleep: Callable[[float], None] = time.sleep,
    pauses: tuple[float, ...] = PAUSES,
) -> bytes:
    """Return the answer of a server to a query.

    Args:
        server: its address.
        query: in Overpass QL.
        timeout: seconds for one try.
        say: is told, in a line, why it takes longer.
        sleep: waits for some seconds.
        pauses: seconds between tries; there is one try more.

    Raises FetchError if the server cannot be reached, is too busy or does not answer as one should, and
    ConfigurationError if it refuses the request.
    """
    for number, pause in enumerate((*pauses, None), start=1):
        try:
            return _try(server, query, timeout)
        except _LaterError as later:
            wait = later.wait if later.wait is not None else pause
            if pause is None:
                raise FetchError(f"{server}: {later}; asked {number} times, try again later") from None
            assert wait is not None
            if wait > LONGEST_PAUSE:
                raise FetchError(f"{server}: {later}; it asks to come back in {wait:.0f} s") from None
            say(f"{server}: {later}; asking again in {wait:.0f} s")
            sleep(wait)
    raise AssertionError("the last try returns or raises")


def _try(server: str, query: str, timeout: float) -> bytes:
    """Ask once; raises _LaterError, FetchError or ConfigurationError."""
    agent = f"dafw/{version('dafw')} (site fetch)"
    asked = Request(
        f"{server}?{urlencode({'data': query})}", headers={"User-Agent": agent, "Accept": "application/json"}
    )
    deadline = time.monotonic() + timeout
    try:
        with urlopen(asked, timeout=timeout) as answer:
            return _content(server, answer, deadline)
    except HTTPError as error:
        said = _page_of(error)
        what = f"status {error.code} {error.reason}{f' ({said})' if said else ''}"
        if error.code == 429 or error.code >= 500:
            raise _LaterError(what, _wait_of(error.headers.get("Retry-After"))) from None
        raise ConfigurationError(f"{server}: {what}; is this the address of an Overpass server?") from None
    except IncompleteRead:
        raise _LaterError("the answer was cut off") from None
    except TimeoutError:
        raise _LaterError(f"no answer in {timeout:g} s") from None
    except URLError as error:
        reason = error.reason
        if isinstance(reason, TimeoutError):
            raise _LaterError(f"no answer in {timeout:g} s") from None
        if isinstance(reason, ConnectionResetError):
            raise _LaterError("the server closed the connection") from None
        raise FetchError(f"{server}: cannot be reached ({getattr(reason, 'strerror', None) or reason})") from None
    except ConnectionError:
        raise _LaterError("the server closed the connection") from None
    except (HTTPException, OSError, ValueError) as error:
        raise FetchError(f"{server}: does not answer as a web server does ({_short(error)})") from None


def _page_of(error: HTTPError) -> str:
    """Return what the page of an error says, if it can be read at all."""
    with suppress(OSError, HTTPException, ValueError), error:
        return words_of_page(error.read(CHUNK))
    return ""


def _content(server: str, answer: Any, deadline: float) -> bytes:
    """Return the bytes of an answer; raises _LaterError if it is cut off or too slow, FetchError if it is too large."""
    parts, size = [], 0
    while part := answer.read1(CHUNK):
        parts.append(part)
        size += len(part)
        if size > LARGEST:
            raise FetchError(f"{server}: the answer is larger than {LARGEST >> 20} MB; ask for a smaller area")
        if time.monotonic() > deadline:
            raise _LaterError("the answer takes too long")
    stated = answer.headers.get("Content-Length", "")
    if stated.isdecimal() and size < int(stated):
        raise _LaterError(f"the answer was cut off after {size} of {stated} bytes")
    return b"".join(parts)


def _wait_of(stated: str | None) -> float | None:
    """Return after how many seconds a server asks to come back: it states a number or a date; None if it does not."""
    if stated is None:
        return None
    if stated.strip().isdecimal():
        return max(1.0, float(stated))
    try:
        date = parsedate_to_datetime(stated)
    except ValueError:
        return None
    date = date if date.tzinfo else date.replace(tzinfo=UTC)
    return max(1.0, (date - datetime.now(UTC)).total_seconds())


def _short(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:120]
