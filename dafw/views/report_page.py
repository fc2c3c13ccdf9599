"""Writes a page: one HTML file with its style, its scripts and its data, which asks nothing of any network.

The page forbids itself, by a content security policy, every script but its own (named by its hash) and every request.
So even if a text of a run could become part of the page's markup, nothing in it would be executed.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from functools import cache
from html import escape
from importlib.resources import files
from typing import Any

import matplotlib
import numpy as np

MAPS = ("magma", "viridis", "cividis")
"""Perceptually uniform colour maps that readers with any colour vision can follow; the first one is the default."""
SIGNED = {"signed": "berlin", "signed light": "RdBu_r"}
"""Colour maps for fields that cross zero: blue below, red above; zero is dark on a dark page."""
IMPORT = re.compile(r'^import \{ (.+) \} from "\./(\w+)\.js";$', re.MULTILINE)
EXPORT = re.compile(r"^export (?=(?:async )?(?:function|const|class) (\w+))", re.MULTILINE)


def page(data: Mapping[str, Any], frame: str = "page", script: str = "main") -> str:
    """Return the page that shows ``data``; with an entry ``live`` it asks its own server for more, and nobody else.

    ``frame`` names its HTML, between head and foot of all pages, and beside the style of all pages its own; ``script``
    the module that puts it together.
    """
    html = "".join(map(_file, ("head.html", f"{frame}.html", "foot.html")))
    return _filled(data, html, bundle(script), "".join(map(_file, dict.fromkeys(["page.css", f"{frame}.css"]))))


def _filled(data: Mapping[str, Any], html: str, script: str, style: str) -> str:
    policy = {
        "default-src": "'none'",
        "script-src": f"'sha256-{_hash(script)}'",
        "style-src": f"'sha256-{_hash(style)}'",
        "img-src": "data:",
        "connect-src": "'self'" if data.get("live") else "'none'",
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    found = {
        "TITLE": escape(str(data.get("title", "dafw"))),
        "POLICY": escape("; ".join(f"{name} {value}" for name, value in policy.items())),
        "STYLE": style,
        "SCRIPT": script,
        "DATA": as_json({**data, "colours": colour_maps()}),
    }
    # In one pass, so that a text of the data that looks like one of these marks stays a text.
    return re.sub(r"\{\{([A-Z]+)\}\}", lambda mark: found[mark[1]], html)


def as_json(data: Any) -> str:
    """Return data as JSON that can stand in an HTML page: it holds no character that begins a tag or a comment."""
    text = json.dumps(data, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


@cache
def bundle(name: str) -> str:
    """Return one script with the module ``name`` of the page and all that it imports.

    A browser does not load modules beside a file that was opened from a disk. So each module becomes a function with
    names of its own, called after the modules that it imports.
    """
    parts: dict[str, str] = {}
    _add(name, parts, ())
    return "\n".join(['"use strict";', "{", "const modules = {};", *parts.values(), "}", ""])


@cache
def colour_maps() -> dict[str, str]:
    """Return 256 colours of each map, three bytes each, in base64.

    ``NAME`` begins at black, for a dark page; ``NAME light`` is turned around and begins at white.
    """
    found: dict[str, str] = {}
    for name in MAPS:
        colours = matplotlib.colormaps[name]
        tables = {
            name: _from(0.0, colours(np.linspace(0.06, 1.0, 256))),
            f"{name} light": _from(1.0, colours(np.linspace(0.94, 0.06, 256))),
        }
        found |= {key: _bytes(table) for key, table in tables.items()}
    levels = np.linspace(0.0, 1.0, 256)
    return found | {key: _bytes(matplotlib.colormaps[name](levels)[:, :3]) for key, name in SIGNED.items()}


def _from(ground: float, colours: np.ndarray) -> np.ndarray:
    """Return colours (256, 3) of which the first twelfth is blended with black (0) or white (1)."""
    share = np.clip(np.arange(256) / 21.0, 0.0, 1.0)[:, np.newaxis]
    return np.asarray(share * colours[:, :3] + (1.0 - share) * ground)


def _bytes(table: np.ndarray) -> str:
    return base64.b64encode(np.rint(255.0 * table).astype(np.uint8).tobytes()).decode("ascii")


def _add(name: str, parts: dict[str, str], above: tuple[str, ...]) -> None:
    """Add a module, after those that it imports, to the parts of a script."""
    if name in above:
        raise ValueError(f"the page's module '{name}' imports itself: {' > '.join([*above, name])}")
    if name in parts:
        return
    text = _file(f"{name}.js")
    for wanted in IMPORT.finditer(text):
        _add(wanted[2], parts, (*above, name))
    text = IMPORT.sub(r"const { \1 } = modules.\2;", text)
    names = ", ".join(EXPORT.findall(text))
    parts[name] = f"modules.{name} = (() => {{\n{EXPORT.sub('', text)}return {{ {names} }};\n}})();"


@cache
def _file(name: str) -> str:
    return (files("dafw.views") / "page" / name).read_text(encoding="utf-8")


def _hash(content: str) -> str:
    return base64.b64encode(hashlib.sha256(content.encode("utf-8")).digest()).decode("ascii")
