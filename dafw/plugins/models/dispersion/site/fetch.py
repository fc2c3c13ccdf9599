"""A site's GeoJSON file from OpenStreetMap, by way of an Overpass server or of the cache of its answers."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

from dafw.core.errors import FetchError, SiteError
from dafw.core.files import atomic_file, write_atomically
from dafw.core.progress import long_task
from dafw.plugins.models.dispersion.site.area import Area
from dafw.plugins.models.dispersion.site.osm import Found, read_answer
from dafw.plugins.models.dispersion.site.overpass import ask, query_of

ATTRIBUTION = "(c) OpenStreetMap contributors, ODbL 1.0, https://www.openstreetmap.org/copyright"
"""What whoever shows the data, or pictures of them, must show with them."""

OLD = 7 * 24 * 3600.0
"""Seconds for which an answer is kept."""


def fetch(
    area: Area,
    file: Path,
    server: str,
    timeout: float,
    *,
    cache: Path,
    anew: bool = False,
    say: Callable[[str], None],
    sleep: Callable[[float], None] = time.sleep,
) -> Found:
    """Write the buildings of an area to a file, complete or not at all, and return them.

    Args:
        area: the rectangle; a building that touches it is fetched as a whole.
        file: a GeoJSON file that ``load_site`` reads.
        server: the address of an Overpass server.
        timeout: seconds for one try.
        cache: the folder in which answers are kept.
        anew: ask the server, even if its answer to the same question was kept.
        say: is told, in a line, what else there is to know.
        sleep: waits for some seconds before the server is asked again.

    Raises FetchError if the server does not answer as it should, ConfigurationError if it refuses the request, and
    SiteError if there is no building in the area.
    """
    question = f"{server} {query_of(area, 1.0)}"  # the same, however long the server may take
    kept = cache / f"overpass-{hashlib.sha256(question.encode()).hexdigest()[:32]}.json"
    found = None if anew else _from_cache(kept, server, area, say)
    if found is None:
        with long_task(f"asking {server}"):
            content = ask(server, query_of(area, timeout), timeout, say=say, sleep=sleep)
        found = read_answer(content, server, area)
        _keep(kept, content, say)
    if not found.features:
        reasons = ", ".join(f"{count} {reason}" for reason, count in found.left_out.items())
        raise SiteError(
            f"no building between longitude {area.west:g} and {area.east:g}, latitude {area.south:g} and "
            f"{area.north:g} ({f'left out: {reasons}' if reasons else 'is the longitude taken for the latitude?'}); "
            f"nothing was written"
        )
    write_atomically(file, _text(found, area))
    return found


def attribution_of(file: Path) -> str:
    """Return whom a GeoJSON file names as the authors of its data, in a line; empty if nobody."""
    try:
        named = json.loads(file.read_text(encoding="utf-8-sig")).get("attribution")
    except (OSError, ValueError, AttributeError, RecursionError):
        return ""
    return " ".join(named.split())[:200] if isinstance(named, str) else ""


def _text(found: Found, area: Area) -> str:
    """Return the GeoJSON, with a line for every building."""
    head = {
        "type": "FeatureCollection",
        "attribution": ATTRIBUTION,
        "date": found.date,
        "generator": f"dafw {version('dafw')} site fetch",
        "area": [area.west, area.south, area.east, area.north],
    }
    lines = ",\n".join(json.dumps(feature, ensure_ascii=False) for feature in found.features)
    return f'{json.dumps(head, ensure_ascii=False)[:-1]}, "features": [\n{lines}\n]}}\n'


def _from_cache(kept: Path, server: str, area: Area, say: Callable[[str], None]) -> Found | None:
    """Return what an answer that was kept says; None if there is none, or it is old or damaged."""
    try:
        age = time.time() - kept.stat().st_mtime
        if not 0 <= age < OLD:
            return None
        found = read_answer(kept.read_bytes(), server, area)
    except (OSError, FetchError):
        return None
    say(f"{server} gave this answer {age / 3600:.1f} hours ago; --anew asks again")
    return found


def _keep(kept: Path, content: bytes, say: Callable[[str], None]) -> None:
    """Keep an answer in the cache, and remove those that are old."""
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(kept) as stream:
            stream.write(content)
    except OSError as error:
        say(f"the answer cannot be kept in {kept.parent} ({error.strerror}); DAFW_CACHE moves the cache")
        return
    for other in kept.parent.glob("overpass-*.json"):
        with suppress(OSError):  # another process tidies up at the same time
            if time.time() - other.stat().st_mtime > OLD:
                other.unlink()
