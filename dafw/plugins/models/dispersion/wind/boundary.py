"""The boundary conditions of the unit wind: which unknowns are prescribed, and their values."""

from __future__ import annotations

from typing import Any

import numpy as np

from dafw.core.errors import ConfigurationError
from dafw.plugins.models.dispersion.fem.mixed_space import MixedSpace
from dafw.plugins.models.dispersion.fem.sparsity import total
from dafw.plugins.models.dispersion.mesh.tagged import OUTER, WALL, TaggedMesh

# isort: split
from dolfinx import fem
from dolfinx.mesh import entities_to_geometry

PARALLEL = 1e-9
"""A facet is parallel to the wind if the scalar product of its normal and the wind, both unit vectors, is at most this.

So the wind is prescribed there, as where it enters.
"""


class WindBoundary:
    """No slip at walls; the wind on the outer boundary.

    With ``uniform`` the wind is prescribed on the full outer boundary, and the pressure is fixed at zero at one node,
    the outermost one in the south-west. With ``outflow`` the wind is prescribed only where it does not leave.
    """

    def __init__(self, space: MixedSpace, tagged_mesh: TaggedMesh, kind: str):
        """Find the unknowns on the boundary; a collective call.

        Raises ConfigurationError if the boundary is ``uniform`` and a building cuts the outer boundary: the inflow
        could not equal the outflow.
        """
        self._space, self._tagged_mesh, self._kind = space, tagged_mesh, kind
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
        points = space.pressure_space.tabulate_dof_coordinates()[: space.pressure_dofs.size]
        first = np.lexsort((points[:, 0], points[:, 0] + points[:, 1]))[:1]
        places = comm.allgather([(x + y, x) for x, y, _ in points[first]])  # an empty list from a rank without nodes
        if places[comm.rank] != [min(place for of_rank in places for place in of_rank)]:
            first = first[:0]
        self._reference = space.pressure_dofs[first]

    def _nodes(self, facets: np.ndarray) -> np.ndarray:
        """Return the P2 nodes on the facets, also on facets of other ranks, that this rank owns."""
        nodes = fem.locate_dofs_topological(self._space.velocity_space, 1, facets)
        return nodes[nodes < self._space.velocity_dofs.size // 2]

    def conditions(self, direction: float) -> tuple[np.ndarray, np.ndarray]:
        """Return which unknowns are prescribed (n,), bool, and their values (n,), zero for all other unknowns.

        Args:
            direction: towards which the air moves, in radians.
        """
        space = self._space
        wind = np.array([np.cos(direction), np.sin(direction)])
        facets, fixed = self._facets, np.zeros(space.unknowns, dtype=bool)
        if self._kind == "outflow":
            facets = facets[self._normals @ wind <= PARALLEL]
        else:
            fixed[self._reference] = True
        lift = np.zeros(space.unknowns)
        components = space.velocity_dofs.reshape(-1, 2)
        for nodes, value in ((self._nodes(facets), wind), (self._wall, np.zeros(2))):
            fixed[components[nodes]] = True
            lift[components[nodes]] = value
        return fixed, lift


def outward_normals(mesh: Any, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the outward unit normals (f, 2) and the lengths (f,), in m, of boundary facets.

    Args:
        mesh: a DOLFINx mesh of triangles.
        facets: (f,) indices of facets on its boundary.
    """
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
