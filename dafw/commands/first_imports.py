"""Imports what ``dafw run`` needs, so that Python compiles it to bytecode once, at set-up; setup.sh runs this by path.

Compiling takes some ten seconds, which the first command would take otherwise. Where PYTHONDONTWRITEBYTECODE is set, as
in many containers, every command and every worker process would take them.
"""

from __future__ import annotations

import importlib
import sys

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

if __name__ == "__main__":
    sys.dont_write_bytecode = False
    del sys.path[0]  # this folder: its modules must not be taken for others of the same name
    for module in MODULES:
        importlib.import_module(module)
