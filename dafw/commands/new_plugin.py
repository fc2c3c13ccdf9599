"""``dafw new-plugin``: writes a package with an example plugin to start from, and its test."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dafw.authoring.templates import new_plugin
from dafw.commands.parser import Parser


def new_plugin_command(words: Sequence[str]) -> int:
    """Write the package and print its files; raises RequestError for a kind, name or folder that cannot be used."""
    parser = Parser(prog="dafw new-plugin", description="Write a package with a plugin to start from, and its test.")
    parser.add_argument("kind", help="model, observer, policy, filter or readings")
    parser.add_argument("name", help="the plugin's name: small letters, digits and '_'")
    parser.add_argument("folder", type=Path, metavar="DIR", help="a folder that is not there yet")
    asked = parser.parse_args(words)
    for path in new_plugin(asked.kind, asked.name, asked.folder):
        print(path)
    return 0
