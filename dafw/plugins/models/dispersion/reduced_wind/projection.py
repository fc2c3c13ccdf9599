"""From winds to a reduced basis: proper orthogonal decomposition and projection of the equations.

Method of snapshots: Sirovich, Quart. Appl. Math. 45 (1987), doi:10.1090/qam/910462; derivatives: Ito and Ravindran,
J. Comput. Phys. 143 (1998), doi:10.1006/jcph.1998.5943.
"""

from __future__ import annotations

import logging
from concurrent.futures import ThreadPoolExecutor
from threading import Lock

import numpy as np

from dafw.core.progress import long_task
from dafw.core.workers import spare_cores
from dafw.plugins.models.dispersion.reduced_wind.basis import ReducedBasis
from dafw.plugins.models.dispersion.reduced_wind.velocity_space import VelocitySpace

FUNCTIONALS = 48
"""Number of random functionals; the standard deviation of the error estimate is then a tenth of it."""
SEED = 4
ROWS = 4096
"""Nodes that are processed at a time, so that intermediate arrays stay in the processor's cache."""
NEGLIGIBLE = 1e-12
"""A mode with less than this part of the energy of all snapshots consists of round-off."""
KNOWN = 1e-10
"""A basis knows a wind if at most this part of the wind's energy lies outside it.

The part outside of a wind that is known need not be divergence-free, so no mode is made of it.
"""

log = logging.getLogger(__name__)


def orthonormal(space: VelocitySpace, vectors: np.ndarray, modes: int, least: float = 0.0) -> np.ndarray:
    """Return the leading modes (2 m, r) of some vectors, orthonormal in the inner product a up to round-off.

    Args:
        space: has the inner product.
        vectors: (2 m, k) velocities in V.
        modes: largest number of modes.
        least: modes with at most this energy are left out, and so are negligible ones.
    """
    gram = vectors.T @ (space.dirichlet @ vectors)
    energies, weights = np.linalg.eigh(gram)
    order = np.argsort(energies)[::-1][:modes]
    order = order[energies[order] > max(least, NEGLIGIBLE * energies.sum())]
    leading = vectors @ (weights[:, order] / np.sqrt(energies[order]))
    for _ in range(2):  # the first pass removes the error from the squared condition number of the Gram matrix
        factor = np.linalg.cholesky(leading.T @ (space.dirichlet @ leading))
        leading = np.linalg.solve(factor, leading.T).T
    return np.ascontiguousarray(leading)


def reduce(
    space: VelocitySpace, parameters: np.ndarray, winds: np.ndarray, derivatives: np.ndarray, modes: int
) -> ReducedBasis:
    """Return the reduced basis of some winds.

    Args:
        space: the velocities of the mesh.
        parameters: (s, 2) unit Reynolds number in 1/m and direction in radians of every wind.
        winds: (2 m, s) velocities of the unit winds.
        derivatives: (2 m, k) their scaled derivatives.
        modes: largest number of modes.
    """
    inner = in_space(space, winds)
    both = np.concatenate([inner, in_space(space, derivatives)], axis=1)
    leading = orthonormal(space, both, modes)
    return project(space, leading, parameters, leading.T @ (space.dirichlet @ inner))


def enrich(space: VelocitySpace, basis: ReducedBasis, parameters: np.ndarray, winds: np.ndarray) -> ReducedBasis:
    """Return a basis that also contains some more winds; ``basis`` itself if it knows them all.

    Args:
        space: the velocities of the mesh.
        basis: the basis so far.
        parameters: (k, 2) unit Reynolds number in 1/m and direction in radians of every wind.
        winds: (2 m, k) velocities of the unit winds.
    """
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
    """Return velocities (2 m, k) minus their Stokes flows, which are orthogonal to V; the difference is in V."""
    product = space.lifts.T @ (space.dirichlet @ np.concatenate([space.lifts, velocities], axis=1))
    return velocities - space.lifts @ np.linalg.solve(product[:, :2], product[:, 2:])


def project(
    space: VelocitySpace,
    modes: np.ndarray,
    parameters: np.ndarray,
    coefficients: np.ndarray,
    known: ReducedBasis | None = None,
) -> ReducedBasis:
    """Return the basis with the given modes.

    Args:
        space: the velocities of the mesh.
        modes: (2 m, r) orthonormal in a.
        parameters: (s, 2) unit Reynolds number in 1/m and direction in radians of every snapshot.
        coefficients: (r, s) coefficients of the snapshots in the modes.
        known: a basis of the first of these modes; its numbers are used instead of computing them again.
    """
    rng = np.random.default_rng(SEED)
    functionals = np.stack([space.riesz(space.noise(rng)) for _ in range(FUNCTIONALS)], axis=1)
    velocities = np.concatenate([space.lifts, modes], axis=1)
    n, r = velocities.shape[1], modes.shape[1]
    first, second = np.triu_indices(n)
    tensor = convection_tensor(space, velocities, functionals, known)
    return ReducedBasis(
        velocities=np.ascontiguousarray(velocities),
        quadratic=tensor[:r],
        gram=velocities.T @ (space.mass @ velocities),
        functionals=functionals.T @ (space.dirichlet @ velocities),
        functionals_quadratic=np.ascontiguousarray(tensor[r:, first, second]),
        parameters=parameters,
        coefficients=np.ascontiguousarray(coefficients.T),
    )


def convection_tensor(
    space: VelocitySpace, velocities: np.ndarray, functionals: np.ndarray, known: ReducedBasis | None
) -> np.ndarray:
    """Return the tensor (r + k, n, n) of int (u_i . grad u_j) . w_l, made symmetric in i and j; its first index is l.

    Args:
        space: the velocities of the mesh.
        velocities: (2 m, n) the velocities u: two Stokes flows, then r modes.
        functionals: (2 m, k) random functionals. The test functions w are the modes, then these.
        known: a basis of the first of these modes; its part of the tensor is used instead of computing it again.
    """
    n = velocities.shape[1]
    tests = np.concatenate([velocities[:, 2:], functionals], axis=1)
    old = known.velocities.shape[1] if known else 0
    added = space.by_component(tests[:, max(old - 2, 0) : n - 2])  # the modes that ``known`` does not have
    tested = np.ascontiguousarray(space.by_component(tests).reshape(space.size, -1).T)
    moved = np.ascontiguousarray(space.by_component(velocities))
    moved_old = space.by_component(velocities[:, :old]).reshape(space.size, -1)
    moved_new = np.ascontiguousarray(space.by_component(velocities[:, old:]))
    tensor = np.zeros((tests.shape[1], n, n))

    assembling = Lock()

    def compute(j: int) -> None:
        with assembling:
            convection = space.convection(velocities[:, j]).copy()
        first, right = (old, moved_new) if j < old else (0, moved)
        for start in range(0, len(moved), ROWS):
            load = (convection[start : start + ROWS] @ right).reshape(-1, n - first)
            tensor[:, j, first:] += tested[:, 2 * start : 2 * start + len(load)] @ load
        if j < old:  # few test functions and many velocities: applying the matrix to the test functions is cheaper
            loads = (convection.T @ added).reshape(space.size, -1)
            tensor[old - 2 : n - 2, j, :old] = loads.T @ moved_old

    # Threads, because BLAS and SciPy work on several at once; each writes its own part of the tensor.
    with (
        long_task(f"reduced basis: projecting on {n - 2} modes", n, "mode") as bar,
        ThreadPoolExecutor(spare_cores()) as pool,
    ):
        for _ in pool.map(compute, range(n)):
            bar.update()
    tensor = 0.5 * (tensor + tensor.transpose(0, 2, 1))
    if known:
        rows, columns = np.triu_indices(old)
        tensor[: old - 2, :old, :old] = known.quadratic
        tensor[n - 2 :, rows, columns] = tensor[n - 2 :, columns, rows] = known.functionals_quadratic
    return tensor
