"""The matrices of the transport that do not depend on the wind, and the unknowns on the outer boundary."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from dafw.core.errors import ContractError
from dafw.plugins.models.dispersion.fem.sparse_lu import Elimination
from dafw.plugins.models.dispersion.fem.sparsity import Sparsity
from dafw.plugins.models.dispersion.mesh.tagged import OUTER, TaggedMesh
from dafw.plugins.models.dispersion.transport.edges import Edges
from dafw.plugins.models.dispersion.transport.options import TransportOptions

# isort: split
import ufl
from dolfinx import fem


class TransportMatrices:
    """Mass and stiffness of P1 elements on one mesh, combined for a step of backward Euler.

    On a mesh that is divided among several ranks, arrays hold the nodes that the rank owns. All P1 matrices of the mesh
    have the same sparsity pattern, so that they add up entry by entry.

    Attributes:
        options: the options of the transport.
        dt: time step in s.
        space: the DOLFINx space.
        sparsity: the sparsity pattern of all matrices; z is its number of entries.
        nodes: number of the nodes.
        places: (nodes, 2) where they are, in m.
        outer: indices of the nodes on the outer boundary.
        fixed: those of them where the concentration is zero: all, or none if the boundary is open.
        row_starts: (nodes,) index of the first entry of every row.
        diagonal: (nodes,) index of the diagonal entry of every row.
        fixed_entries: indices of the entries in rows and columns of fixed nodes.
        fixed_diagonal: indices of the diagonal entries of fixed nodes.
        before: the SciPy matrix that acts on the old concentration, in a step without wind.
        stiffness: (z,) CSR values of the stiffness matrix.
        calm: (z,) CSR values of the matrix that acts on the new concentration, in a step without wind.
    """

    def __init__(self, tagged_mesh: TaggedMesh, options: TransportOptions, dt: float):
        mesh = tagged_mesh.mesh
        self.options, self.dt = options, dt
        self.space = fem.functionspace(mesh, ("Lagrange", 1))
        c, v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        mass = fem.form(c * v * ufl.dx)
        stiffness = fem.form(ufl.inner(ufl.grad(c), ufl.grad(v)) * ufl.dx)

        self.sparsity = Sparsity(mass)
        self.nodes = self.sparsity.size
        indptr, indices, rows = self.sparsity.indptr, self.sparsity.indices, self.sparsity.rows
        self.places: np.ndarray = self.space.tabulate_dof_coordinates()[: self.nodes, : mesh.geometry.dim]
        outer = fem.locate_dofs_topological(self.space, mesh.topology.dim - 1, tagged_mesh.facet_tags.find(OUTER))
        self.outer: np.ndarray = outer[outer < self.nodes]
        self.fixed = self.outer if options.outflow == "zero" else self.outer[:0]
        fixed = np.zeros(self.nodes, dtype=bool)
        fixed[self.fixed] = True
        self.row_starts, self.diagonal = indptr[:-1].astype(np.intp), np.flatnonzero(rows == indices)
        self.fixed_entries = np.flatnonzero(fixed[rows] | self.sparsity.with_ghosts(fixed)[indices])
        self.fixed_diagonal = self.diagonal[self.fixed]
        self.before = self.sparsity.csr(self.assemble(mass) / dt)
        self.stiffness = self.assemble(stiffness)
        self.calm = self.before.data + options.diffusion * self.stiffness

    @cached_property
    def edges(self) -> Edges:
        """The edges of the mesh, for flux-corrected transport."""
        return Edges(self.sparsity)

    @cached_property
    def elimination(self) -> Elimination:
        """The order in which factorisations of these matrices eliminate the nodes; for meshes of one process."""
        return Elimination(self.sparsity.indptr, self.sparsity.indices)

    def after(self, added: np.ndarray, out: np.ndarray) -> np.ndarray:
        """Write the CSR values (z,) of the matrix that acts on the new concentration to ``out``, and return it.

        Args:
            added: (z,) CSR values that the wind adds.
            out: (z,) overwritten.
        """
        np.add(self.calm, added, out=out)
        out[self.fixed_entries] = 0.0
        out[self.fixed_diagonal] = 1.0
        return out

    def supplied(self, concentration: np.ndarray, source: np.ndarray | None) -> np.ndarray:
        """Return the concentration (nodes,) with what a source adds to it in a step.

        Args:
            concentration: (nodes,) at the start of the step.
            source: (nodes,) rate f at the end of the step, in concentration per second; None is no source.

        Raises ContractError if an array has another shape.
        """
        self.require_nodal(concentration, source)
        return concentration if source is None else concentration + self.dt * source

    def require_nodal(self, *arrays: np.ndarray | None) -> None:
        """Raise ContractError if an array is not None and has another shape than (nodes,)."""
        for array in arrays:
            if array is not None and array.shape != (self.nodes,):
                raise ContractError(f"transport: expected {self.nodes} nodal values, got shape {array.shape}")

    def assemble(self, form: Any) -> np.ndarray:
        """Return the CSR values (z,) of a bilinear form of the space."""
        return self.sparsity.assemble(form).copy()

    def outward(self, advection: np.ndarray) -> np.ndarray:
        """Return how much air leaves through the outer boundary near its nodes, (outer nodes,) in m^2/s.

        At node i that is the integral of phi_i w.n, negative where the wind enters. It is the sum of column i of the
        advection matrix, since the wind is free of divergence against every P1 function. For meshes of one process.

        Args:
            advection: (z,) CSR values of the advection matrix of the wind.
        """
        sums: np.ndarray = np.bincount(self.sparsity.indices, advection, minlength=self.nodes)[self.outer]
        return sums
