"""Imports what ``dafw run`` needs, so that Python compiles it to bytecode once, at set-up; setup.sh runs this by path.

Compiling takes some ten seconds, which the first command would take otherwise. Where PYTHONDONTWRITEBYTECODE is set, as
in many containers, every command and every worker process would take them. Beside it, on another core, numba compiles
the loops of a step, which takes as long and is kept in a cache, too.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterator
from typing import Any

MODULES = (
    "dafw.commands.run",
    "dafw.core.composition",
    "dafw.plugins.models.dispersion.mesh.generate",
    "dafw.plugins.models.dispersion.transport.flux_corrected",
    "dafw.plugins.models.dispersion.wind_solvers",
    "dafw.studies.running",
    "dafw.views",
    "dask.array",  # xarray imports it when it opens a run
    "scipy.interpolate",
)

EDGES, INDICES, NUMBERS, TABLE = "uint32[::1]", "int64[::1]", "float64[::1]", "float64[:, ::1]"

LOOPS = {
    "dafw.plugins.models.dispersion.transport.march:march": (
        *(EDGES, EDGES, NUMBERS, NUMBERS, NUMBERS, EDGES, EDGES, TABLE, TABLE, TABLE, INDICES, TABLE, TABLE),
        *("boolean[::1]", "float64", NUMBERS, TABLE, TABLE, NUMBERS),
    ),
    "dafw.plugins.models.dispersion.transport.low_order:low_order": (
        *(EDGES, EDGES, EDGES, EDGES, INDICES, NUMBERS, "float64", "boolean[::1]", TABLE, TABLE),
    ),
    "dafw.plugins.models.dispersion.fem.paired_lu:spread": (NUMBERS, NUMBERS, EDGES, EDGES, TABLE),
    "dafw.plugins.models.dispersion.fem.paired_lu:factorise": (EDGES, EDGES, TABLE, TABLE, TABLE),
}
"""The compiled functions that a step of the default study calls, and the types of their arguments."""


def loops() -> Iterator[tuple[Any, tuple[Any, ...]]]:
    """Yield these functions, each with numba's types of its arguments."""
    from numba.core.sigutils import normalize_signature

    for name, kinds in LOOPS.items():
        module, _, function = name.partition(":")
        arguments, _ = normalize_signature(f"({', '.join(kinds)},)")
        yield getattr(importlib.import_module(module), function), arguments


def main() -> int:
    """Import and compile in two processes; return 1 if a loop cannot be compiled."""
    other = os.fork()
    if other == 0:
        for function, signature in loops():
            function.compile(signature)
        return 0
    for module in MODULES:
        importlib.import_module(module)
    _, status = os.waitpid(other, 0)
    return int(status != 0)


if __name__ == "__main__":
    sys.dont_write_bytecode = False
    del sys.path[0]  # this folder: its modules must not be taken for others of the same name
    sys.exit(main())
