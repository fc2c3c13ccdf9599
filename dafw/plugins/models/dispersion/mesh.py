"""The triangle mesh of a site: gmsh makes it, a cache keeps it, DOLFINx reads it."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dafw.core.errors import RequestError
from dafw.core.making import making
from dafw.plugins.models.dispersion.mesh_options import MeshOptions
from dafw.plugins.models.dispersion.site import Site

OUTER, WALL = 1, 2
"""Facet tags: the outer rectangle, and the walls of the buildings."""

FORMAT = 1
"""Counts the ways in which this module made meshes; part of what names a cached file."""

log = logging.getLogger(__name__)


class MeshError(RequestError):
    """A mesh cannot be made as asked for, or a mesh file cannot be used."""


@dataclass(frozen=True)
class TaggedMesh:
    """A DOLFINx mesh in metres with its boundary facets tagged ``OUTER`` or ``WALL``; the file that it came from."""

    mesh: Any
    facet_tags: Any
    file: Path | None = None


def generate(site: Site, options: MeshOptions) -> Path:
    """Return the .msh file of a site, made now unless the cache holds it; equal input gives equal bytes.

    The cache is the folder ``DAFW_CACHE``, or else the user's cache folder; a file's name is the digest of all that
    defines it. Raises MeshError where the options make no sense, the mesh would be too large, or gmsh fails.
    """
    from dafw.plugins.models.dispersion.sizing import size_function

    _check(site, options)
    path = cache_folder() / f"mesh-{_digest(site, options)}.msh"
    try:
        if path.exists():
            if _is_whole(path):
                return path
            log.warning("mesh file %s is damaged: it is made anew", path)
    except OSError as error:
        raise MeshError(f"mesh: cannot read {path} ({error.strerror}); DAFW_CACHE moves the cache") from None
    size = size_function(site, options)
    try:
        with making(path.parent) as folder:
            made = folder / "mesh.msh"
            with _gmsh() as gmsh:
                _draw(gmsh, site)
                gmsh.model.mesh.setSizeCallback(size)
                gmsh.model.mesh.generate(2)
                gmsh.write(str(made))
            content = made.read_bytes()
            made.write_bytes(content + _seal(content))
            made.replace(path)
    except OSError as error:
        raise MeshError(
            f"mesh: cannot write to the cache {path.parent} ({error.strerror}); DAFW_CACHE moves it"
        ) from None
    return path


def load(path: Path, comm: Any = None) -> TaggedMesh:
    """Read a file of ``generate`` into DOLFINx, on MPI.COMM_SELF unless told otherwise.

    On a communicator of several ranks, which call together, the mesh is partitioned among them; rank 0 reads.
    Raises MeshError where the file is missing or damaged, or a facet of its boundary is not tagged.
    """
    from dafw.plugins.models.dispersion import libraries  # noqa: F401, I001  (before dolfinx)
    from dolfinx.io import gmsh as dolfinx_gmsh
    from dolfinx.mesh import exterior_facet_indices
    from mpi4py import MPI

    comm = MPI.COMM_SELF if comm is None else comm
    problem = comm.bcast(_unreadable(path) if comm.rank == 0 else "")
    if problem:
        raise MeshError(f"mesh file {path}: {problem}")
    if comm.rank == 0:
        with _gmsh() as gmsh:
            gmsh.merge(str(path))
            data = dolfinx_gmsh.model_to_mesh(gmsh.model, comm, 0, gdim=2)
    else:
        data = dolfinx_gmsh.model_to_mesh(None, comm, 0, gdim=2)
    mesh, tags = data.mesh, data.facet_tags
    mesh.topology.create_connectivity(1, 2)
    if not all(comm.allgather(np.array_equal(np.sort(tags.indices), np.sort(exterior_facet_indices(mesh.topology))))):
        raise MeshError(f"mesh file {path}: {len(tags.indices)} facets are tagged, expected exactly the boundary")
    return TaggedMesh(mesh, tags, path)


def topology(tagged: TaggedMesh) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes (nodes, 2) in m and triangles (faces, 3), int32, counter-clockwise.

    Nodes are numbered like the degrees of freedom of the P1 space on the mesh, triangles like its cells.
    """
    from dolfinx.fem import functionspace

    space = functionspace(tagged.mesh, ("Lagrange", 1))
    nodes = space.tabulate_dof_coordinates()[:, :2].copy()
    triangles = space.dofmap.list.astype(np.int32)
    a, b, c = nodes[triangles].transpose(1, 2, 0)
    clockwise = (b[0] - a[0]) * (c[1] - a[1]) < (b[1] - a[1]) * (c[0] - a[0])
    triangles[clockwise, 1:] = triangles[clockwise, :0:-1]
    return nodes, triangles


def _check(site: Site, options: MeshOptions) -> None:
    """Raise MeshError where options make no sense or ask for too many nodes."""
    from dafw.plugins.models.dispersion.sizing import expected_nodes

    for name in ("wall_size", "far_size", "transition", "across", "max_nodes"):
        value = getattr(options, name)
        if not 0 < value < float("inf"):
            raise MeshError(f"mesh: expected {name} above 0, got {value}")
    if options.far_size < options.wall_size:
        raise MeshError(
            f"mesh: expected a far_size of at least the wall_size, {options.wall_size:g} m, got {options.far_size:g} m"
        )
    if not site.domain.is_valid:  # gmsh would not come back from crossing walls
        raise MeshError("mesh: expected buildings that are disjoint and inside the rectangle of the site")
    nodes = expected_nodes(site, options)
    if nodes > options.max_nodes:
        raise MeshError(
            f"mesh: about {nodes:.2g} nodes are asked for, expected at most {options.max_nodes} (max_nodes)"
        )


def cache_folder() -> Path:
    """Return the folder that meshes are kept in: ``DAFW_CACHE``, or else the user's cache folder."""
    from platformdirs import user_cache_dir

    return Path(os.environ.get("DAFW_CACHE") or user_cache_dir("dafw"))


def _digest(site: Site, options: MeshOptions) -> str:
    """Name everything that a mesh depends on."""
    import gmsh

    defining = {
        "format": FORMAT,
        "gmsh": gmsh.__version__,
        "bounds": site.bounds,
        "buildings": [[list(corner) for corner in building.exterior.coords] for building in site.buildings],
        "options": asdict(options),
    }
    return hashlib.sha256(json.dumps(defining, sort_keys=True).encode()).hexdigest()[:32]


def _seal(content: bytes) -> bytes:
    """A closing section that gmsh passes over and that shows a damaged file for what it is."""
    return f"$Comments\nsha256 {hashlib.sha256(content).hexdigest()}\n$EndComments\n".encode()


def _unreadable(path: Path) -> str:
    """Return why a file cannot be read, nothing where it can."""
    if not path.is_file():
        return "not found"
    return "" if _is_whole(path) else "damaged, expected a file made by dafw (delete it, and it is made anew)"


def _is_whole(path: Path) -> bool:
    content, mark, _ = (whole := path.read_bytes()).rpartition(b"$Comments\n")
    return bool(mark) and whole == content + _seal(content)


@contextmanager
def _gmsh() -> Iterator[Any]:
    """Give gmsh with a fresh model: quiet, one thread, no start-up files, no signal handlers; left as it was found."""
    import gmsh

    running = bool(gmsh.isInitialized())
    if not running:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        for source in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
            gmsh.option.setNumber(f"Mesh.MeshSize{source}", 0)
        gmsh.option.setNumber("Mesh.LcIntegrationPrecision", 1e-3)
        gmsh.option.setNumber("Mesh.Algorithm", 6)
        gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
        gmsh.model.add("dafw")
        yield gmsh
    except Exception as error:
        # gmsh raises nothing more telling than Exception; whatever is more telling is not gmsh's
        if type(error) is not Exception:
            raise
        raise MeshError(f"mesh: gmsh failed ({error})") from None
    finally:
        if running:
            gmsh.model.remove()
        else:
            gmsh.finalize()


def _draw(gmsh: Any, site: Site) -> None:
    """Draw the rectangle with its holes, and name the parts that the solvers need."""
    geo, loops, curves = gmsh.model.geo, [], []
    for ring in (site.domain.exterior, *site.domain.interiors):
        points = [geo.addPoint(x, y, 0.0) for x, y in list(ring.coords)[:-1]]
        lines = [geo.addLine(a, b) for a, b in zip(points, points[1:] + points[:1], strict=True)]
        loops.append(geo.addCurveLoop(lines))
        curves.append(lines)
    surface = geo.addPlaneSurface(loops)
    geo.synchronize()
    gmsh.model.addPhysicalGroup(1, curves[0], OUTER)
    if curves[1:]:
        gmsh.model.addPhysicalGroup(1, [line for lines in curves[1:] for line in lines], WALL)
    gmsh.model.addPhysicalGroup(2, [surface], 1)
