"""The reference of the built-in plugins, made from what ``dafw plugins NAME --json`` prints."""

from __future__ import annotations

import json
import re

from dafw.core.options import REQUIRED, Described
from dafw.core.registry import KINDS, registry

TITLES = {
    "model": "Models",
    "observer": "Observers",
    "policy": "Policies",
    "filter": "Filters",
    "readings": "Sources of readings",
    "executor": "Executors",
}


def plugin_pages() -> dict[str, str]:
    """Return by kind a page in Markdown with all plugins of dafw of that kind and their options."""
    known = registry()
    pages = {}
    for kind in KINDS:
        parts = [f"# {TITLES[kind]}"]
        for plugin in known.plugins():
            if plugin.spec.kind == kind and plugin.spec.target.startswith("dafw."):
                module = plugin.spec.target.partition(":")[0].replace(".", "/")
                summary = f"{plugin.spec.summary[:1].upper()}{plugin.spec.summary[1:]}."
                parts.append(f"## {plugin.spec.name}\n\n{summary} Code: [{module}.py](../{module}.py).")
                parts.append(listed(known.options(kind, plugin.spec.name)))
        pages[kind] = "\n\n".join(parts) + "\n"
    return pages


def listed(options: list[Described]) -> str:
    """Return options as a list of definitions."""
    if not options:
        return "It has no options."
    entries = []
    for one in options:
        default = "must be given" if one.default is REQUIRED else f"default `{json.dumps(one.default)}`"
        facts = ", ".join(filter(None, [f"`{one.type}`", one.accepted, default]))
        entries.append(f"**`{one.name}`** {facts}\n: {escaped(one.help)}")
    return "\n\n".join(entries)


def escaped(text: str) -> str:
    """Return a text whose characters mean nothing but themselves in Markdown."""
    return re.sub(r"([\\`*_{}\[\]<>$|])", r"\\\1", text)
