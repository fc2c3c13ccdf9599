"""``dafw plugins``: what is installed, and the options of a plugin."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from dafw.commands.parser import Parser
from dafw.core.errors import PluginError
from dafw.core.options import REQUIRED
from dafw.core.registry import registry


def plugins_command(words: Sequence[str]) -> int:
    """Print all plugins, or the options of those with the given name; raises PluginError for an unknown name."""
    parser = Parser(prog="dafw plugins", description="List the plugins, or the options of those with this name.")
    parser.add_argument("name", nargs="?", help="a plugin's name: list its options")
    parser.add_argument("--json", action="store_true", help="for machines")
    asked = parser.parse_args(words)
    rows = []
    for plugin in registry().named(asked.name) if asked.name else registry().plugins():
        row: dict[str, Any] = {"kind": plugin.spec.kind, "name": plugin.spec.name, "package": plugin.package}
        row["summary"] = plugin.spec.summary
        if asked.name or asked.json:
            try:
                row["options"] = registry().options(plugin.spec.kind, plugin.spec.name)
            except PluginError as error:
                row["problem"] = str(error)
        rows.append(row)
    if asked.json:
        problems_listed = [vars(problem) for problem in registry().problems]
        for row in rows:
            if "options" in row:
                row["options"] = [option.plain() for option in row["options"]]
        print(json.dumps({"plugins": rows, "problems": problems_listed}, indent=2, allow_nan=False))
        return 0
    for row in rows:
        print(f"{row['kind']:<9} {row['name']:<12} {row['summary']}  [{row['package']}]")
        for option in row.get("options", []):
            default = option.default
            shown = default if isinstance(default, str) and default else json.dumps(default, default=str)
            value = "must be given" if default is REQUIRED else f"= {shown}"
            accepted = f" ({option.accepted})" if option.accepted else ""
            print(f"    {option.name}: {option.type} {value}{accepted}    {option.help}")
        if "problem" in row:
            print(f"    {row['problem']}")
    for problem in registry().problems:
        print(f"problem   {problem.package}: {problem.message}")
    return 0
