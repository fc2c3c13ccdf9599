"""Nobody imports upwards: commands -> studies, views, authoring -> plugins -> core. Imports in functions count."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import dafw

PACKAGE = Path(dafw.__file__).parent
BELOW = {
    "core": set(),
    "plugins": {"core"},
    "authoring": {"plugins", "core"},
    "views": {"plugins", "core"},
    "studies": {"views", "plugins", "core"},  # from views, because a run ends with its pictures
    "commands": {"studies", "views", "authoring", "plugins", "core"},
}
"""The folders from which each folder may import, besides itself."""
FACES = {
    "__init__": {"studies", "views", "authoring", "plugins", "core"},
    "__main__": {"commands"},
    "testing": {"authoring"},
}
"""The modules beside these folders, for users only: no folder may import them."""
MODULES = sorted(path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py"))


def rooms_of_imports(source: str, module: Path) -> set[str]:
    """Return the folders and top-level modules of dafw from which a module at a path in the package imports."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            # One dot is the folder of the module, each further one the folder above.
            start = [".".join(("dafw", *module.parts[: len(module.parts) - node.level]))] if node.level else []
            base = ".".join([*start, *([node.module] if node.module else [])])
            names = [f"{base}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            first, _, rest = name.partition(".")
            if first == "dafw":
                room = rest.partition(".")[0]
                found.add(room if room in BELOW or room in FACES else "__init__")
    return found


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_a_module_imports_from_its_own_room_and_those_below(module):
    imported = rooms_of_imports((PACKAGE / module).read_text(encoding="utf-8"), module)
    room = module.parts[0]
    allowed = BELOW[room] | {room} if len(module.parts) > 1 else FACES[module.stem]
    assert imported <= allowed


@pytest.mark.parametrize(
    ("source", "module", "rooms"),
    [
        ("import dafw.views.maps as maps, numpy", "core/a.py", {"views"}),
        ("from dafw.core import space", "plugins/a.py", {"core"}),
        ("from dafw import commands, studies", "core/a.py", {"commands", "studies"}),
        ("from dafw import testing", "core/a.py", {"testing"}),
        ("from dafw import Model", "core/a.py", {"__init__"}),
        ("import dafw", "core/a.py", {"__init__"}),
        ("def late():\n    from dafw.authoring.kit import CHECKS", "plugins/models/a.py", {"authoring"}),
        ("from . import b", "core/a.py", {"core"}),
        ("from ...core.space import Variable", "plugins/models/a.py", {"core"}),
        ("from ..views import maps", "plugins/__init__.py", {"views"}),
        ("from dafwish.views import maps", "core/a.py", set()),
    ],
)
def test_every_form_of_import_is_seen(source, module, rooms):
    assert rooms_of_imports(source, Path(module)) == rooms
