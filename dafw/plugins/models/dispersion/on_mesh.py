"""What models on the mesh of a site have in common: the site, its mesh, and the mesh as the ranks of MPI divide it.

Like model.py this module must be light.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dafw.core.interfaces import Model
from dafw.core.options import option
from dafw.core.sharing import Shared
from dafw.core.space import Array
from dafw.plugins.models.dispersion.mesh.options import MeshOptions
from dafw.plugins.models.dispersion.mesh.tagged import TaggedMesh
from dafw.plugins.models.dispersion.site.options import SiteOptions

if TYPE_CHECKING:
    from dafw.plugins.models.dispersion.site.site import Site


@dataclass
class OnMesh(Model):
    """A model on a triangular mesh of a site."""

    site: SiteOptions = option(SiteOptions, "the site")
    mesh: MeshOptions = option(MeshOptions, "the mesh")

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
