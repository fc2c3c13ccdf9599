"""Which reduced basis a solver uses: the one that is asked for by its digest, the one as made, or an enriched one."""

from __future__ import annotations

import hashlib
import json
import logging
from dataclasses import asdict, replace
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from dafw.plugins.models.dispersion.cache import cache_folder
from dafw.plugins.models.dispersion.mesh.tagged import TaggedMesh
from dafw.plugins.models.dispersion.reduced_wind.basis import ReducedBasis
from dafw.plugins.models.dispersion.reduced_wind.projection import enrich, reduce
from dafw.plugins.models.dispersion.reduced_wind.snapshots import snapshots
from dafw.plugins.models.dispersion.reduced_wind.store import BasisStore, StoredBasis
from dafw.plugins.models.dispersion.reduced_wind.velocity_space import VelocitySpace
from dafw.plugins.models.dispersion.wind.options import WindOptions
from dafw.plugins.models.dispersion.wind.solver import WindSolver

FORMAT = 1
"""Part of what names the folder of a basis; raise it when a change to the code changes the bases."""
MOST_AT_ONCE = 40
"""Winds that are added to a basis at a time; every mode makes all later solves a little slower."""
LARGEST = 2
"""An enriched basis has at most this many times the modes that were asked for."""

log = logging.getLogger(__name__)


def basis_for(tagged_mesh: TaggedMesh, options: WindOptions) -> StoredBasis:
    """Return the basis for a mesh and options, which does not change while it is used.

    - With ``basis.digest`` it is the basis of that name.
    - Without ``basis.enrich`` it is the basis as it was made, and it is made if there is none. Its bits depend only on
      the mesh and the options.
    - With ``basis.enrich`` it is the newest enriched basis, and the winds that wait are added to it now.

    Raises ConfigurationError if the basis of that name is not there, or if the cache cannot be written to.
    """
    store = _store(tagged_mesh, options)
    if wanted := options.basis.digest:
        return StoredBasis(store, wanted, store.load(wanted))
    # With one thread in every process the bits of a basis do not depend on the number of cores.
    with store.lock(), threadpool_limits(limits=1):
        found = (store.find("enriched") if options.basis.enrich else None) or store.find("made")
        digest, basis = found or _made(tagged_mesh, options, store)
        if options.basis.enrich:
            digest, basis = _enriched(tagged_mesh, options, store, digest, basis)
    return StoredBasis(store, digest, basis)


def is_made(tagged_mesh: TaggedMesh, options: WindOptions) -> bool:
    """Return whether the cache holds the basis for a mesh and options, so that no run has to make it."""
    return (_store(tagged_mesh, options).folder / "made").exists()


def _made(tagged_mesh: TaggedMesh, options: WindOptions, store: BasisStore) -> tuple[str, ReducedBasis]:
    """Make a basis and save it."""
    basis = build(tagged_mesh, options)
    return store.save(basis, "made"), basis


def _enriched(
    tagged_mesh: TaggedMesh, options: WindOptions, store: BasisStore, digest: str, basis: ReducedBasis
) -> tuple[str, ReducedBasis]:
    """Add the winds that wait to a basis and save it; return it as it is if none waits or it is full."""
    room = LARGEST * options.basis.modes - basis.quadratic.shape[0]
    waiting = store.waiting(len(basis.velocities), min(room, MOST_AT_ONCE))
    if not waiting:
        return digest, basis
    solver = WindSolver(tagged_mesh, options)
    space = VelocitySpace(solver.problem, solver.boundary)
    parameters = np.stack([wind.parameters for wind in waiting])
    winds = np.stack([wind.velocity for wind in waiting], axis=1)
    richer = enrich(space, basis, parameters, winds)
    digest = store.save(richer, "enriched")
    for wind in waiting:  # only now, so that a process that is killed before loses none of them
        wind.path.unlink(missing_ok=True)
    return digest, richer


def require_basis(tagged_mesh: TaggedMesh, options: WindOptions) -> None:
    """Raise ConfigurationError if ``options`` name a basis that is missing for this mesh, or damaged."""
    if options.basis.digest:
        _store(tagged_mesh, options).content(options.basis.digest)


def build(tagged_mesh: TaggedMesh, options: WindOptions) -> ReducedBasis:
    """Solve the winds of the grid and return their reduced basis; some minutes on a large mesh.

    Raises WindError if no wind can be solved.
    """
    begun = perf_counter()
    solver = WindSolver(tagged_mesh, replace(options, keep_factorisation=True))
    found = snapshots(solver, tagged_mesh.file)
    solved = perf_counter()
    space = VelocitySpace(solver.problem, solver.boundary)
    basis = reduce(space, found.parameters, found.winds, found.derivatives, options.basis.modes)
    log.info(
        "reduced basis: %d winds in %.1f s, projected on %d modes in %.1f s",
        len(found.parameters),
        solved - begun,
        basis.quadratic.shape[0],
        perf_counter() - solved,
    )
    return basis


def _store(tagged_mesh: TaggedMesh, options: WindOptions) -> BasisStore:
    return BasisStore(cache_folder() / f"wind-basis-{key(tagged_mesh, options)}")


def key(tagged_mesh: TaggedMesh, options: WindOptions) -> str:
    """Return the digest of everything that a basis depends on."""
    mesh, tags = tagged_mesh.mesh, tagged_mesh.facet_tags
    content = hashlib.sha256()
    for array in (mesh.geometry.x, mesh.geometry.dofmaps[0], tags.indices, tags.values):
        content.update(np.ascontiguousarray(array).tobytes())
    defining = asdict(options)
    for name in ("solver", "keep_factorisation"):
        del defining[name]
    for name in ("digest", "enrich", "tolerance"):
        del defining["basis"][name]
    content.update(json.dumps({"format": FORMAT, "options": defining}, sort_keys=True).encode())
    return content.hexdigest()[:32]
