"""Which unknowns of the unit wind its boundary prescribes, and with what values."""

from __future__ import annotations

from typing import Any

import numpy as np

from dafw.core.errors import ConfigurationError
from dafw.plugins.models.dispersion.mesh import OUTER, WALL, TaggedMesh
from dafw.plugins.models.dispersion.sparsity import total
from dafw.plugins.models.dispersion.taylor_hood import TaylorHood

# isort: split
from dolfinx import fem
from dolfinx.mesh import entities_to_geometry

PARALLEL = 1e-9
"""The outer boundary is parallel to the wind where wind and normal, both of unit length, multiply to this or less."""


class WindBoundary:
    """No slip on walls; the wind on all of the outer boundary (``uniform``) or where it does not leave (``outflow``).

    Where the wind is prescribed all round, one pressure is fixed at zero: that of the outermost south-western node.
    """

    def __init__(self, problem: TaylorHood, tagged_mesh: TaggedMesh, kind: str):
        """Find the boundary's unknowns.

        Raises ConfigurationError where buildings cut the outer boundary of a wind that is ``uniform``: what blows in
        could not blow out.
        """
        self._problem, self._tagged_mesh, self._kind = problem, tagged_mesh, kind
        self._facets = tagged_mesh.facet_tags.find(OUTER)
        self._wall = self._nodes(tagged_mesh.facet_tags.find(WALL))
        self._normals, lengths = outward_normals(tagged_mesh.mesh, self._facets)
        comm = tagged_mesh.mesh.comm
        gap = float(np.linalg.norm(total(comm, lengths @ self._normals)))
        if kind == "uniform" and gap > 1e-9 * total(comm, lengths.sum()):
            raise ConfigurationError(
                f"wind: boundary 'uniform' expects an outer boundary that no building cuts, got one with {gap:.4g} m "
                "missing: leave a margin around the buildings or choose boundary 'outflow'"
            )
        points = problem.pressure_space.tabulate_dof_coordinates()[: problem.pressure_dofs.size]
        first = np.lexsort((points[:, 0], points[:, 0] + points[:, 1]))[:1]
        places = comm.allgather([(x + y, x) for x, y, _ in points[first]])  # nothing from a rank without nodes
        if places[comm.rank] != [min(place for of_rank in places for place in of_rank)]:
            first = first[:0]
        self._reference = problem.pressure_dofs[first]

    def _nodes(self, facets: np.ndarray) -> np.ndarray:
        """Return the P2 nodes on facets, other ranks' facets too, that this rank owns."""
        nodes = fem.locate_dofs_topological(self._problem.velocity_space, 1, facets)
        return nodes[nodes < self._problem.velocity_dofs.size // 2]

    def conditions(self, direction: float) -> tuple[np.ndarray, np.ndarray]:
        """Return which unknowns are prescribed, (n,) of bool, and their values with zeros elsewhere, (n,)."""
        problem = self._problem
        wind = np.array([np.cos(direction), np.sin(direction)])
        facets, fixed = self._facets, np.zeros(problem.unknowns, dtype=bool)
        if self._kind == "outflow":
            facets = facets[self._normals @ wind <= PARALLEL]
        else:
            fixed[self._reference] = True
        lift = np.zeros(problem.unknowns)
        components = problem.velocity_dofs.reshape(-1, 2)
        for nodes, value in ((self._nodes(facets), wind), (self._wall, np.zeros(2))):
            fixed[components[nodes]] = True
            lift[components[nodes]] = value
        return fixed, lift


def outward_normals(mesh: Any, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the outward unit normals (f, 2) and the lengths (f,) of boundary facets of a triangle mesh."""
    mesh.topology.create_connectivity(1, 2)
    cells = np.array([mesh.topology.connectivity(1, 2).links(facet)[0] for facet in facets], dtype=np.int32)
    ends = mesh.geometry.x[entities_to_geometry(mesh, 1, facets)][:, :, :2]
    centres = mesh.geometry.x[mesh.geometry.dofmaps[0][cells]][:, :, :2].mean(axis=1)
    along = ends[:, 1] - ends[:, 0]
    lengths = np.linalg.norm(along, axis=1)
    normals = np.column_stack([along[:, 1], -along[:, 0]]) / lengths[:, None]
    inward = np.einsum("ij,ij->i", normals, centres - ends[:, 0]) > 0.0
    normals[inward] *= -1.0
    return normals, lengths
