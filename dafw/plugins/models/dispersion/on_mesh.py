"""What models on the mesh of a site have in common: the site, its mesh, and the mesh as the ranks of MPI divide it.

Like model.py this module must be light.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from dafw.core.errors import ConfigurationError
from dafw.core.interfaces import Model
from dafw.core.options import option
from dafw.core.sharing import Shared
from dafw.core.space import Array
from dafw.plugins.models.dispersion.mesh.options import CoarseMeshOptions, MeshOptions
from dafw.plugins.models.dispersion.mesh.tagged import TaggedMesh
from dafw.plugins.models.dispersion.site.options import SiteOptions

if TYPE_CHECKING:
    from dafw.plugins.models.dispersion.site.site import Site


@dataclass
class OnMesh(Model):
    """A model on a triangular mesh of a site."""

    site: SiteOptions = option(SiteOptions, "the site")
    mesh: MeshOptions = option(MeshOptions, "the mesh")
    coarse_mesh: CoarseMeshOptions = option(CoarseMeshOptions, "the mesh of the coarser version, for coarse_search")

    _shared: Shared = field(default_factory=Shared, init=False, repr=False, compare=False)
    _communicator: Any = field(default=None, init=False, repr=False)

    @cached_property
    def place(self) -> Site:
        """The site; raises SiteError."""
        from dafw.plugins.models.dispersion.site.site import load_site

        return self._shared.once(("site", repr(self.site)), lambda: load_site(self.site))

    @cached_property
    def ground(self) -> Site:
        """The site of the mesh: without buildings, since with a wind through walls the transport would be ill-posed."""
        return replace(self.place, buildings=(), names=(), types=())

    def coarser(self) -> Self:
        """Return the same model on its ``coarse_mesh``; raises ConfigurationError if that is not given."""
        return self._coarser

    @cached_property
    def _coarser(self) -> Self:
        if not self.coarse_mesh.given:
            raise ConfigurationError(
                f"{self.label}: the filter or the policy needs a coarser mesh, and there is none: give "
                f"coarse_mesh.wall_size or another option of coarse_mesh"
            )
        coarser = replace(self, mesh=replace(self.mesh, **self.coarse_mesh.given), coarse_mesh=CoarseMeshOptions())
        coarser.name = self.name
        coarser.share_with(self._shared)
        return coarser

    def share_with(self, shared: Shared) -> None:
        """Use ``shared`` for the site, the mesh and what is computed from them."""
        self._shared = shared

    @cached_property
    def _mesh_file(self) -> Path:
        from dafw.plugins.models.dispersion.mesh.generate import generate

        return generate(self.ground, self.mesh)

    @cached_property
    def tagged_mesh(self) -> TaggedMesh:
        """The mesh of ``ground``, as one process holds it."""
        from dafw.plugins.models.dispersion.mesh.load import load

        file = self._mesh_file
        return self._shared.once(("mesh", file), lambda: load(file))

    @cached_property
    def solver_mesh(self) -> TaggedMesh:
        """The mesh that the solvers work on: ``tagged_mesh``, or the same mesh divided among the ranks."""
        from dafw.plugins.models.dispersion.mesh.load import load

        file, communicator = self._mesh_file, self._communicator
        if communicator is None:
            return self.tagged_mesh
        return self._shared.once(("divided mesh", file, communicator.handle), lambda: load(file, communicator))

    @cached_property
    def _topology(self) -> tuple[Array, Any]:
        """The nodes (nodes, 2) in m and the triangles (faces, 3)."""
        from dafw.plugins.models.dispersion.mesh.load import topology

        mesh = self.tagged_mesh
        return self._shared.once(("topology", mesh), lambda: topology(mesh))
