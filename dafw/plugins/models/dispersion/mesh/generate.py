"""Make the triangle mesh of a site with gmsh, unless the cache holds it."""

from __future__ import annotations

import hashlib
import json
import logging
from dataclasses import asdict
from pathlib import Path

import gmsh

from dafw.core.making import making
from dafw.core.progress import long_task
from dafw.plugins.models.dispersion.cache import cache_folder
from dafw.plugins.models.dispersion.mesh.gmsh_file import checksum_section, gmsh_session, is_intact
from dafw.plugins.models.dispersion.mesh.options import MeshOptions
from dafw.plugins.models.dispersion.mesh.sizing import expected_nodes, size_function
from dafw.plugins.models.dispersion.mesh.tagged import OUTER, WALL, MeshError
from dafw.plugins.models.dispersion.site.site import Site

FORMAT = 1
"""Part of what names a cached file; raise it when a change here changes the meshes."""

log = logging.getLogger(__name__)


def generate(site: Site, options: MeshOptions) -> Path:
    """Return the .msh file of a site, which is made unless the cache holds it; equal input gives equal bytes.

    The name of the file is the digest of everything that defines the mesh. Raises MeshError if the options contradict
    each other, the mesh would be too large, gmsh fails, or the cache cannot be used.
    """
    _check(site, options)
    path = cache_folder() / f"mesh-{_digest(site, options)}.msh"
    try:
        if path.exists():
            if is_intact(path):
                return path
            log.warning("mesh file %s is damaged: it is made anew", path)
    except OSError as error:
        raise MeshError(f"mesh: cannot read {path} ({error.strerror}); DAFW_CACHE moves the cache") from None
    size = size_function(site, options)
    try:
        with long_task("making the mesh"), making(path.parent) as folder:
            made = folder / "mesh.msh"
            with gmsh_session():
                _draw(site)
                gmsh.model.mesh.setSizeCallback(size)
                gmsh.model.mesh.generate(2)
                gmsh.write(str(made))
            content = made.read_bytes()
            made.write_bytes(content + checksum_section(content))
            made.replace(path)
    except OSError as error:
        raise MeshError(
            f"mesh: cannot write to the cache {path.parent} ({error.strerror}); DAFW_CACHE moves it"
        ) from None
    return path


def _check(site: Site, options: MeshOptions) -> None:
    """Raise MeshError if the options contradict each other or ask for too many nodes."""
    for name in ("wall_size", "far_size", "transition", "across", "max_nodes"):
        value = getattr(options, name)
        if not 0 < value < float("inf"):
            raise MeshError(f"mesh: expected {name} above 0, got {value}")
    if options.far_size < options.wall_size:
        raise MeshError(
            f"mesh: expected a far_size of at least the wall_size, {options.wall_size:g} m, got {options.far_size:g} m"
        )
    if not site.domain.is_valid:  # gmsh does not return when walls cross
        raise MeshError("mesh: expected buildings that are disjoint and inside the rectangle of the site")
    nodes = expected_nodes(site, options)
    if nodes > options.max_nodes:
        raise MeshError(
            f"mesh: about {nodes:.2g} nodes are asked for, expected at most {options.max_nodes} (max_nodes)"
        )


def _digest(site: Site, options: MeshOptions) -> str:
    """Return the digest of everything that defines a mesh."""
    defining = {
        "format": FORMAT,
        "gmsh": gmsh.__version__,
        "bounds": site.bounds,
        "buildings": [[list(corner) for corner in building.exterior.coords] for building in site.buildings],
        "options": asdict(options),
    }
    return hashlib.sha256(json.dumps(defining, sort_keys=True).encode()).hexdigest()[:32]


def _draw(site: Site) -> None:
    """Draw the rectangle with the buildings as holes, and tag its boundary and its area."""
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
