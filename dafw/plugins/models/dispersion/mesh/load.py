"""Read the mesh file of a site into DOLFINx."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gmsh
import numpy as np

from dafw.plugins.models.dispersion import fem as _libraries  # noqa: F401  (before dolfinx)
from dafw.plugins.models.dispersion.mesh.gmsh_file import gmsh_session, is_intact
from dafw.plugins.models.dispersion.mesh.tagged import MeshError, TaggedMesh

# isort: split
from dolfinx.fem import functionspace
from dolfinx.io import gmsh as dolfinx_gmsh
from dolfinx.mesh import exterior_facet_indices
from mpi4py import MPI


def load(path: Path, comm: Any = None) -> TaggedMesh:
    """Read a file that ``generate`` made.

    On a communicator of several ranks this is a collective call: rank 0 reads the file, and DOLFINx divides the mesh
    among the ranks.

    Args:
        path: the .msh file.
        comm: an MPI communicator; None is that of this process alone, MPI.COMM_SELF.

    Raises MeshError if the file is missing or damaged, or if a facet of the boundary has no tag.
    """
    comm = MPI.COMM_SELF if comm is None else comm
    problem = comm.bcast(_unreadable(path) if comm.rank == 0 else "")
    if problem:
        raise MeshError(f"mesh file {path}: {problem}")
    if comm.rank == 0:
        with gmsh_session():
            gmsh.merge(str(path))
            data = dolfinx_gmsh.model_to_mesh(gmsh.model, comm, 0, gdim=2)
    else:
        data = dolfinx_gmsh.model_to_mesh(None, comm, 0, gdim=2)
    mesh, tags = data.mesh, data.facet_tags
    mesh.topology.create_connectivity(1, 2)
    if not all(comm.allgather(np.array_equal(np.sort(tags.indices), np.sort(exterior_facet_indices(mesh.topology))))):
        raise MeshError(f"mesh file {path}: {len(tags.indices)} facets are tagged, expected exactly the boundary")
    return TaggedMesh(mesh, tags, path)


def _unreadable(path: Path) -> str:
    """Return why a file cannot be read; empty if it can."""
    if not path.is_file():
        return "not found"
    return "" if is_intact(path) else "damaged, expected a file made by dafw (delete it, and it is made anew)"


def topology(tagged: TaggedMesh) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes (nodes, 2) in m and the triangles (faces, 3), int32, counter-clockwise.

    Nodes are numbered like the degrees of freedom of the P1 space on the mesh, triangles like its cells.
    """
    space = functionspace(tagged.mesh, ("Lagrange", 1))
    nodes = space.tabulate_dof_coordinates()[:, :2].copy()
    triangles = space.dofmap.list.astype(np.int32)
    a, b, c = nodes[triangles].transpose(1, 2, 0)
    clockwise = (b[0] - a[0]) * (c[1] - a[1]) < (b[1] - a[1]) * (c[0] - a[0])
    triangles[clockwise, 1:] = triangles[clockwise, :0:-1]
    return nodes, triangles
