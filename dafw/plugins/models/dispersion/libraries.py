"""Imported before DOLFINx and PETSc wherever they are used: finds the libraries, and starts PETSc.

``dolfinx_solver`` puts the wheel's libraries where DOLFINx looks for them. PETSc would take over SIGTERM and abort the
process; a run that is asked to stop must be able to keep what it has done.
"""

from __future__ import annotations

import dolfinx_solver  # noqa: F401
import petsc4py

petsc4py.init(["dafw", "-no_signal_handler"])
