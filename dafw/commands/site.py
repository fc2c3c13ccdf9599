"""``dafw site``: a site's buildings from OpenStreetMap, and what a study would make of them, before it is run."""

from __future__ import annotations

import os
import re
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from dafw.commands.parser import Parser
from dafw.core.errors import ConfigurationError

SERVER = "DAFW_OVERPASS"
"""Environment variable that may name another Overpass server than the public one."""


def site_command(words: Sequence[str]) -> int:
    """Fetch or preview a site; raises DafwError."""
    commands = {"fetch": fetch_command, "preview": preview_command}
    if words[:1] in (["-h"], ["--help"]):
        print("usage: dafw site fetch ... | dafw site preview FILE ...; each with --help says more")
        return 0
    if not words or words[0] not in commands:
        raise ConfigurationError(f"site: expected fetch or preview, got {words[0] if words else 'nothing'}")
    return commands[words[0]](words[1:])


def fetch_command(words: Sequence[str]) -> int:
    """Write the buildings of an area to a file; raises DafwError."""
    parser = Parser(
        prog="dafw site fetch",
        description="Ask an Overpass server for the buildings of an area in OpenStreetMap, and write them to a GeoJSON "
        "file that model.site.file reads.",
    )
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--bbox", metavar="W,S,E,N", help="a rectangle in degrees of longitude and latitude")
    where.add_argument(
        "--around",
        metavar="LAT,LON,RADIUS",
        help="a square whose sides are RADIUS metres from a place in degrees, as maps name it: latitude first",
    )
    parser.add_argument(
        "-o", "--out", type=Path, default=Path("site.geojson"), metavar="FILE", help="default: %(default)s"
    )
    parser.add_argument("--force", action="store_true", help="overwrite the file if there is one")
    parser.add_argument(
        "--server", metavar="URL", help=f"the Overpass server; default: {SERVER}, or else the public one"
    )
    parser.add_argument(
        "--timeout", type=float, default=60.0, metavar="S", help="seconds for one of up to four tries; default: 60"
    )
    parser.add_argument("--anew", action="store_true", help="ask again, even if the answer of the last days was kept")
    asked = parser.parse_args(_with_negative_values(words))
    if not 1.0 <= asked.timeout <= 3600.0:
        raise ConfigurationError(f"site fetch: expected a --timeout between 1 and 3600 s, got {asked.timeout:g}")
    file: Path = asked.out
    if file.exists() and not asked.force:
        raise ConfigurationError(f"{file}: exists already; nothing was changed (--force overwrites it)")
    if not file.parent.is_dir() or file.is_dir():
        raise ConfigurationError(f"{file}: cannot be written, expected a file in a folder that exists")
    # Here, because they load shapely and pyproj, which --help does not need.
    from dafw.plugins.models.dispersion.cache import cache_folder
    from dafw.plugins.models.dispersion.site.area import area_around, area_between
    from dafw.plugins.models.dispersion.site.fetch import ATTRIBUTION, fetch
    from dafw.plugins.models.dispersion.site.overpass import PUBLIC_SERVER, require_server

    area = area_between(asked.bbox) if asked.bbox is not None else area_around(asked.around)
    server = asked.server or os.environ.get(SERVER) or PUBLIC_SERVER
    require_server(server)
    found = fetch(area, file, server, asked.timeout, cache=cache_folder(), anew=asked.anew, say=_say)
    count = len(found.features)
    date = f", data of {found.date}" if found.date else ""
    print(f"{file}: {count} building{'' if count == 1 else 's'}{date}")
    for reason, count in sorted(found.left_out.items()):
        print(f"{count} left out: {reason}")
    if found.incomplete:
        print(f"{found.incomplete} with a part of their outline missing, kept without it")
    print(ATTRIBUTION)
    print(f"next: dafw site preview {shlex.quote(str(file))}")
    return 0


def _with_negative_values(words: Sequence[str]) -> list[str]:
    """Return the words with ``--bbox -1,2,3,4`` as one word: argparse would take the numbers for an option."""
    joined: list[str] = []
    for word in words:
        if joined and joined[-1] in ("--bbox", "--around") and re.match(r"-[\d.]", word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _say(line: str) -> None:
    print(f"dafw: {line}", file=sys.stderr, flush=True)


def preview_command(words: Sequence[str]) -> int:
    """Draw a site with a study on it, or serve a page on which to place release and drones; raises DafwError."""
    parser = Parser(
        prog="dafw site preview",
        description="Draw a site as a study would use it: buildings, what was done to them, mesh, release, drones and "
        "wind. Prints the command that runs it.",
    )
    parser.add_argument("file", metavar="FILE", help="a GeoJSON file, or 'plant' for the site that ships with dafw")
    parser.add_argument("overrides", nargs="*", metavar="OVERRIDE", help="as for dafw run, such as experiment=leak")
    parser.add_argument(
        "-o", "--out", type=Path, metavar="FILE.png", help="the picture; default: NAME_preview.png here"
    )
    parser.add_argument(
        "--serve",
        action="store_true",
        help="show a page on this machine on which release and drones are placed by a click; Ctrl-C ends it",
    )
    parser.add_argument("--port", type=int, default=0, help="of the page; default: one that is free")
    asked = parser.parse_intermixed_args(words)
    picture: Path = asked.out or Path(f"{Path(asked.file).stem}_preview.png")
    if picture.suffix.lower() != ".png":
        raise ConfigurationError(f"site preview: expected a picture's name that ends in .png, got {picture}")
    if not 0 <= asked.port < 2**16:
        raise ConfigurationError(f"site preview: port {asked.port} cannot be used (expected 0 to 65535)")
    # Here, because they load Hydra and matplotlib, which --help does not need.
    from dafw.views.site_preview import preview_of

    preview = preview_of(asked.file, asked.overrides)
    if asked.serve:
        from dafw.studies.stopping import stop_signals
        from dafw.views.site_server import SiteServer, serve

        server = SiteServer(preview, asked.port)  # before the signals are set: PETSc, which reads the mesh, resets them
        with stop_signals():
            serve(server)
        return 0
    print("\n".join(preview.site.report_lines()))
    print("\n".join(preview.size_lines()))
    configured, free = preview.places, preview.free_places
    for (name, place), (_, instead) in zip(preview.named(configured), preview.named(free), strict=True):
        print(preview.about(name, place))
        if instead != place:
            print(f"  free ground near it: {preview.about(name, instead)}")
    for name, place in preview.further:
        print(preview.about(name, place))
    from dafw.views.files import save
    from dafw.views.site_picture import plot_site

    print(save(plot_site(preview), picture))
    print(preview.command(free))
    return 0
