"""The reduced basis of one mesh: winds solved in full, their derivatives, proper orthogonal decomposition, projection.

Method of snapshots: Sirovich, Quart. Appl. Math. 45 (1987), doi:10.1090/qam/910462; derivatives: Ito and Ravindran,
J. Comput. Phys. 143 (1998), doi:10.1006/jcph.1998.5943.
"""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from dafw.plugins.models.dispersion.reduced_flow import ReducedBasis
from dafw.plugins.models.dispersion.snapshots import snapshots
from dafw.plugins.models.dispersion.velocity_space import VelocitySpace

if TYPE_CHECKING:
    from dafw.plugins.models.dispersion.wind import WindSolver

FUNCTIONALS = 48
"""Random functionals of the estimate: its own standard deviation is one tenth of it."""
SEED = 4
ROWS = 4096
"""Nodes dealt with at a time: what is made for them stays in the processor's cache."""
NEGLIGIBLE = 1e-12
"""Share of the snapshots' energy below which there is nothing but round-off."""
KNOWN = 1e-10
"""Share of a wind's energy outside a basis up to which the basis knows it; so little need not be free of divergence."""

log = logging.getLogger(__name__)


def orthonormal(space: VelocitySpace, vectors: np.ndarray, modes: int, least: float = 0.0) -> np.ndarray:
    """Return the leading ``modes`` of vectors (2 v, k) in the inner product a, orthonormal to round-off.

    Modes of an energy up to ``least`` are left out, and those that are negligible.
    """
    gram = vectors.T @ (space.dirichlet @ vectors)
    energies, weights = np.linalg.eigh(gram)
    order = np.argsort(energies)[::-1][:modes]
    order = order[energies[order] > max(least, NEGLIGIBLE * energies.sum())]
    leading = vectors @ (weights[:, order] / np.sqrt(energies[order]))
    for _ in range(2):  # the first pass leaves what the squared condition number of the Gram matrix spoilt
        factor = np.linalg.cholesky(leading.T @ (space.dirichlet @ leading))
        leading = np.linalg.solve(factor, leading.T).T
    return np.ascontiguousarray(leading)


def build(solver: WindSolver, mesh_file: Path | None = None) -> ReducedBasis:
    """Solve the winds of the grid and project: some minutes on a large mesh, in several processes where it has a file.

    Raises WindError where no wind can be solved.
    """
    begun = perf_counter()
    found = snapshots(solver, mesh_file)
    solved = perf_counter()
    space = VelocitySpace(solver.problem, solver.boundary)
    inner = in_space(space, found.winds)
    both = np.concatenate([inner, in_space(space, found.derivatives)], axis=1)
    modes = orthonormal(space, both, solver.options.basis.modes)
    basis = project(space, modes, found.parameters, modes.T @ (space.dirichlet @ inner))
    log.info(
        "reduced basis: %d winds in %.1f s, projected on %d modes in %.1f s",
        len(found.parameters),
        solved - begun,
        modes.shape[1],
        perf_counter() - solved,
    )
    return basis


def enrich(solver: WindSolver, basis: ReducedBasis, parameters: np.ndarray, winds: np.ndarray) -> ReducedBasis:
    """Return a basis that holds these winds (2 v, k) of R and d (k, 2), too; the same one where it knows them all."""
    space = VelocitySpace(solver.problem, solver.boundary)
    modes = basis.velocities[:, 2:]
    inner = in_space(space, winds)
    new = inner - modes @ (modes.T @ (space.dirichlet @ inner))
    new -= modes @ (modes.T @ (space.dirichlet @ new))
    energies = np.einsum("ij,ij->j", inner, space.dirichlet @ inner)
    new = orthonormal(space, new / np.sqrt(np.maximum(energies, np.finfo(float).tiny)), new.shape[1], KNOWN)
    log.info("reduced basis: %d more winds, %d more modes", len(parameters), new.shape[1])
    if not new.shape[1]:
        return basis
    both = np.concatenate([modes, new], axis=1)
    known = np.pad(basis.coefficients, ((0, 0), (0, new.shape[1])))
    coefficients = np.concatenate([known.T, both.T @ (space.dirichlet @ inner)], axis=1)
    return project(space, both, np.concatenate([basis.parameters, parameters]), coefficients, basis)


def in_space(space: VelocitySpace, velocities: np.ndarray) -> np.ndarray:
    """Return velocities (2 v, k) less their Stokes flows, which are orthogonal to V."""
    product = space.lifts.T @ (space.dirichlet @ np.concatenate([space.lifts, velocities], axis=1))
    return velocities - space.lifts @ np.linalg.solve(product[:, :2], product[:, 2:])


def project(
    space: VelocitySpace,
    modes: np.ndarray,
    parameters: np.ndarray,
    coefficients: np.ndarray,
    known: ReducedBasis | None = None,
) -> ReducedBasis:
    """Return the basis with modes (2 v, r), orthonormal in a, and coefficients (r, s) of the snapshots.

    ``known`` is a basis of the first of these modes: what it has is not computed again.
    """
    rng = np.random.default_rng(SEED)
    functionals = np.stack([space.riesz(space.noise(rng)) for _ in range(FUNCTIONALS)], axis=1)
    velocities = np.concatenate([space.lifts, modes], axis=1)
    n, r = velocities.shape[1], modes.shape[1]
    first, second = np.triu_indices(n)
    tensor = carried(space, velocities, functionals, known)
    return ReducedBasis(
        velocities=np.ascontiguousarray(velocities),
        quadratic=tensor[:r],
        gram=velocities.T @ (space.mass @ velocities),
        functionals=functionals.T @ (space.dirichlet @ velocities),
        functionals_quadratic=np.ascontiguousarray(tensor[r:, first, second]),
        parameters=parameters,
        coefficients=np.ascontiguousarray(coefficients.T),
    )


def carried(
    space: VelocitySpace, velocities: np.ndarray, functionals: np.ndarray, known: ReducedBasis | None
) -> np.ndarray:
    """Return int (u_j . grad u_k) . w_i, made symmetric in j and k, (i, n, n), of velocities u (2 v, n).

    The tests w are the velocities without the two lifts, then the functionals (2 v, m). What ``known`` has is taken
    from there.
    """
    from tqdm import tqdm

    n = velocities.shape[1]
    tests = np.concatenate([velocities[:, 2:], functionals], axis=1)
    old = known.velocities.shape[1] if known else 0
    added = space.by_component(tests[:, max(old - 2, 0) : n - 2])  # tests that ``known`` has not
    tested = np.ascontiguousarray(space.by_component(tests).reshape(space.size, -1).T)
    moved = np.ascontiguousarray(space.by_component(velocities))
    moved_old = space.by_component(velocities[:, :old]).reshape(space.size, -1)
    moved_new = np.ascontiguousarray(space.by_component(velocities[:, old:]))
    tensor = np.zeros((tests.shape[1], n, n))
    for j in tqdm(range(n), desc="projection of the reduced basis", unit="mode", disable=None, file=sys.stderr):
        convection = space.convection(velocities[:, j])
        first, right = (old, moved_new) if j < old else (0, moved)
        for start in range(0, len(moved), ROWS):
            load = (convection[start : start + ROWS] @ right).reshape(-1, n - first)
            tensor[:, j, first:] += tested[:, 2 * start : 2 * start + len(load)] @ load
        if j < old:  # few tests and many velocities: the matrix is cheaper on the tests' side
            loads = (convection.T @ added).reshape(space.size, -1)
            tensor[old - 2 : n - 2, j, :old] = loads.T @ moved_old
    tensor = 0.5 * (tensor + tensor.transpose(0, 2, 1))
    if known:
        rows, columns = np.triu_indices(old)
        tensor[: old - 2, :old, :old] = known.quadratic
        tensor[n - 2 :, rows, columns] = tensor[n - 2 :, columns, rows] = known.functionals_quadratic
    return tensor
