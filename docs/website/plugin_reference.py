"""The reference of the built-in plugins, made from what ``dafw plugins NAME --json`` prints."""

from __future__ import annotations

import json

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
                parts.append(table(known.options(kind, plugin.spec.name)))
        pages[kind] = "\n\n".join(parts) + "\n"
    return pages


def table(options: list[Described]) -> str:
    """Return options as a table."""
    if not options:
        return "It has no options."
    rows = [("option", "type", "default", "accepted", "meaning"), ("---",) * 5]
    for one in options:
        default = "must be given" if one.default is REQUIRED else f"`{json.dumps(one.default)}`"
        rows.append((f"`{one.name}`", f"`{one.type}`", default, one.accepted, one.help))
    return "\n".join("| " + " | ".join(cell(text) for text in row) + " |" for row in rows)


def cell(text: str) -> str:
    """Return a text as it must stand in a table."""
    return text.replace("|", "\\|").replace("<", "\\<") if not text.startswith("`") else text.replace("|", "\\|")
