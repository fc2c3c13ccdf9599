"""Finite elements and linear algebra with DOLFINx and PETSc, as plain NumPy arrays.

Importing this package finds the libraries of DOLFINx and starts PETSc, so modules elsewhere import something of it
before they import ``dolfinx`` or ``petsc4py``:

- ``dolfinx_solver`` puts the shared libraries of its wheel where DOLFINx looks for them.
- PETSc is started without its signal handler. With it, SIGTERM would abort the process, and a run that is asked to stop
  could not write what it has done.
"""

from __future__ import annotations

import dolfinx_solver  # noqa: F401
import petsc4py

petsc4py.init(["dafw", "-no_signal_handler"])
