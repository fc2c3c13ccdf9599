"""Which reduced basis a solver uses: the one that was asked for, the newest, or one made now."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from dafw.plugins.models.dispersion.basis_file import BasisStore
from dafw.plugins.models.dispersion.mesh import TaggedMesh, cache_folder
from dafw.plugins.models.dispersion.reduced_flow import ReducedBasis

if TYPE_CHECKING:
    from dafw.plugins.models.dispersion.wind import WindOptions

FORMAT = 1
"""Counts the ways in which a basis was made; part of what names its folder."""
MOST_AT_ONCE = 40
"""Winds taken in at one time: each makes every later solve a little dearer."""
LARGEST = 2
"""An enriched basis has at most this many times the modes that were asked for."""


def basis_for(tagged_mesh: TaggedMesh, options: WindOptions) -> tuple[BasisStore, str, ReducedBasis]:
    """Return the store, the digest and the basis of a mesh and options; made now where there is none.

    Winds that wait are taken in here and nowhere else, so that a basis in use never changes. Raises ConfigurationError
    where the basis asked for by its digest is not there.
    """
    store = _store(tagged_mesh, options)
    if wanted := options.basis.digest:
        return store, wanted, store.load(wanted)
    # One thread, in this process as in others: the bits of a basis must not depend on the number of cores.
    with store.lock(), threadpool_limits(limits=1):
        digest, basis = store.newest() or _made(tagged_mesh, options, store)
        room = LARGEST * options.basis.modes - basis.quadratic.shape[0]
        waiting = store.waiting(len(basis.velocities), min(room, MOST_AT_ONCE))
        if waiting:
            from dafw.plugins.models.dispersion.reduced_basis import enrich
            from dafw.plugins.models.dispersion.wind import WindSolver

            parameters = np.stack([wind.parameters for wind in waiting])
            winds = np.stack([wind.velocity for wind in waiting], axis=1)
            digest = store.save(basis := enrich(WindSolver(tagged_mesh, options), basis, parameters, winds))
            for wind in waiting:  # only now: whoever is cut off before begins again
                wind.path.unlink(missing_ok=True)
    return store, digest, basis


def require_basis(tagged_mesh: TaggedMesh, options: WindOptions) -> None:
    """Raise ConfigurationError where ``options`` name a basis that is not there for this mesh, or is damaged."""
    if options.basis.digest:
        _store(tagged_mesh, options).content(options.basis.digest)


def _store(tagged_mesh: TaggedMesh, options: WindOptions) -> BasisStore:
    return BasisStore(cache_folder() / f"wind-basis-{key(tagged_mesh, options)}")


def _made(tagged_mesh: TaggedMesh, options: WindOptions, store: BasisStore) -> tuple[str, ReducedBasis]:
    from dafw.plugins.models.dispersion.reduced_basis import build
    from dafw.plugins.models.dispersion.wind import WindSolver

    basis = build(WindSolver(tagged_mesh, replace(options, keep_factorisation=True)), tagged_mesh.file)
    return store.save(basis), basis


def key(tagged_mesh: TaggedMesh, options: WindOptions) -> str:
    """Name everything that a basis depends on."""
    mesh, tags = tagged_mesh.mesh, tagged_mesh.facet_tags
    content = hashlib.sha256()
    for array in (mesh.geometry.x, mesh.geometry.dofmaps[0], tags.indices, tags.values):
        content.update(np.ascontiguousarray(array).tobytes())
    defining = asdict(options)
    for name in ("solver", "keep_factorisation"):
        del defining[name]
    for name in ("digest", "tolerance"):
        del defining["basis"][name]
    content.update(json.dumps({"format": FORMAT, "options": defining}, sort_keys=True).encode())
    return content.hexdigest()[:32]
