"""The modules of the dispersion models import only from lower ones, also within functions."""

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import dafw.plugins.models.dispersion as package

ROOT = Path(package.__file__).parent
NAME = package.__name__

ORDER = (
    "cache",
    "site",
    "fem",
    "mesh",
    "wind",
    "transport",
    "reduced_wind",
    "wind_solvers",
    "plausible",
    "sources",
    "wind_change",
    "unknowns",
    "on_mesh",
    "model",
)
"""Folders and modules, the lowest first; no module imports a later one."""


def modules():
    """Return the path of every module by its name below the package."""
    names = {}
    for path in ROOT.rglob("*.py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        names[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return names


def imports():
    """Return the modules of the package that each of them imports, anywhere in its text."""
    known = modules()
    found = {name: set() for name in known}
    for name, path in known.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module and f"{node.module}.".startswith(f"{NAME}."):
                module = node.module.removeprefix(NAME).lstrip(".")
                inner = {f"{module}.{alias.name}".lstrip(".") for alias in node.names}
                found[name] |= (inner & known.keys()) or {module}
    return found


def floors(graph):
    """Return the length of the longest chain of imports; raises graphlib.CycleError if there is a circle."""
    height = {}
    for name in TopologicalSorter(graph).static_order():
        height[name] = 1 + max((height[below] for below in graph.get(name, ())), default=0)
    return max(height.values())


def test_no_circle_and_few_floors():
    graph = imports()
    assert len(graph) > 30 and sum(map(len, graph.values())) > 60
    assert floors(graph) <= 8
    rooms = {}
    for name, below in graph.items():
        room = name.partition(".")[0]
        rooms.setdefault(room, set()).update({other.partition(".")[0] for other in below} - {room})
    assert floors(rooms) <= 6


def test_no_room_imports_one_above_it():
    place = {room: number for number, room in enumerate(ORDER)} | {"": -1, "model_ins": len(ORDER)}
    for name, below in imports().items():
        for other in below:
            assert place[other.partition(".")[0]] <= place[name.partition(".")[0]], f"{name} imports {other}"


def test_options_are_declared_without_heavy_imports():
    script = f"import sys, {NAME}.model_ins; print(*sorted(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    heavy = {"gmsh", "shapely", "pyproj", "dolfinx", "dolfinx_solver", "petsc4py", "mpi4py", "scipy", "matplotlib"}
    assert not heavy & set(loaded)
