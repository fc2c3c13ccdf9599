"""The mixed space of velocity (P2) and pressure (P1) on one mesh of triangles."""

from __future__ import annotations

from typing import Any

import basix.ufl
import numpy as np
from dolfinx import fem


class MixedSpace:
    """Velocity and pressure; on a divided mesh, arrays hold the unknowns that this rank owns.

    Attributes:
        space: the mixed DOLFINx space, velocity first.
        velocity_space: the P2 vector space.
        pressure_space: the P1 space.
        velocity_dofs: (2 m,) index of the mixed unknown of every unrolled dof of ``velocity_space`` (x and y
            alternate).
        pressure_dofs: (k,) index of the mixed unknown of every dof of ``pressure_space``.
        unknowns: their number n = 2 m + k.
    """

    def __init__(self, mesh: Any):
        velocity = basix.ufl.element("Lagrange", mesh.basix_cell(), 2, shape=(mesh.geometry.dim,))
        pressure = basix.ufl.element("Lagrange", mesh.basix_cell(), 1)
        self.space = fem.functionspace(mesh, basix.ufl.mixed_element([velocity, pressure]))
        self.velocity_space, velocity_dofs = self.space.sub(0).collapse()
        self.pressure_space, pressure_dofs = self.space.sub(1).collapse()
        # DOLFINx numbers the unknowns of other ranks last.
        nodes, points = self.velocity_space.dofmap.index_map.size_local, self.pressure_space.dofmap.index_map.size_local
        self.velocity_dofs = np.array(velocity_dofs).ravel()[: 2 * nodes]
        self.pressure_dofs = np.array(pressure_dofs).ravel()[:points]
        self.unknowns: int = self.velocity_dofs.size + self.pressure_dofs.size

    def velocity(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the dofs (2 m,) of ``velocity_space`` of a mixed vector (n,)."""
        return unknowns[self.velocity_dofs]
