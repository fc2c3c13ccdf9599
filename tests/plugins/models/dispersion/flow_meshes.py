"""Small triangle meshes with tagged boundaries: squares cut in four; a quarter turn maps them to themselves."""

import dolfinx_solver  # noqa: F401  (before dolfinx)

# isort: split
import basix.ufl
import numpy as np
import ufl
from dolfinx import mesh as dolfinx_mesh
from mpi4py import MPI

from dafw.plugins.models.dispersion.mesh.tagged import OUTER, WALL, TaggedMesh


def rectangle(columns, rows, size=(1.0, 1.0), holes=()):
    """A rectangle from the origin; ``holes`` are (x0, y0, x1, y1) along lines of the grid, and may touch its edge."""
    x, y = np.linspace(0, size[0], columns + 1), np.linspace(0, size[1], rows + 1)
    corners = np.array([(a, b) for b in y for a in x])
    centres = np.array([(a, b) for b in (y[1:] + y[:-1]) / 2 for a in (x[1:] + x[:-1]) / 2])
    triangles = []
    for k, (a, b) in enumerate(centres):
        if any(x0 < a < x1 and y0 < b < y1 for x0, y0, x1, y1 in holes):
            continue
        south_west = k // columns * (columns + 1) + k % columns
        ring = [south_west, south_west + 1, south_west + columns + 2, south_west + columns + 1]
        triangles += [(ring[i], ring[(i + 1) % 4], len(corners) + k) for i in range(4)]
    used, cells = np.unique(np.array(triangles), return_inverse=True)
    points = np.vstack([corners, centres])[used]
    domain = ufl.Mesh(basix.ufl.element("Lagrange", "triangle", 1, shape=(2,)))
    mesh = dolfinx_mesh.create_mesh(MPI.COMM_SELF, cells.reshape(-1, 3).astype(np.int64), domain, points)
    mesh.topology.create_connectivity(1, 2)
    facets = dolfinx_mesh.exterior_facet_indices(mesh.topology)
    middles = dolfinx_mesh.compute_midpoints(mesh, 1, facets)[:, :2]
    rim = np.isclose(middles, 0.0).any(axis=1) | np.isclose(middles, size).any(axis=1)
    tags = np.where(rim, OUTER, WALL).astype(np.int32)
    return TaggedMesh(mesh, dolfinx_mesh.meshtags(mesh, 1, facets, tags))
