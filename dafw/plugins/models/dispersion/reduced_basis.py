"""The reduced basis of one mesh: winds solved in full, their derivatives, proper orthogonal decomposition, projection.

Snapshots lie on a grid of directions and of unit Reynolds numbers R that crowd towards R = 0, where most winds are.
Each brings along its derivatives to R and d, which cost two triangular solves with a factorisation that is there.
Method of snapshots: Sirovich, Quart. Appl. Math. 45 (1987), doi:10.1090/qam/910462; derivatives: Ito and Ravindran,
J. Comput. Phys. 143 (1998), doi:10.1006/jcph.1998.5943.
"""

from __future__ import annotations

import logging
import sys
from typing import TYPE_CHECKING

import numpy as np

from dafw.plugins.models.dispersion.reduced_flow import ReducedBasis
from dafw.plugins.models.dispersion.velocity_space import VelocitySpace

if TYPE_CHECKING:
    from dafw.plugins.models.dispersion.wind import WindOptions, WindSolver

FUNCTIONALS = 48
"""Random functionals of the estimate: its own standard deviation is one tenth of it."""
SEED = 4
NEGLIGIBLE = 1e-12
"""Share of the snapshots' energy below which there is nothing but round-off."""

log = logging.getLogger(__name__)


def grid(options: WindOptions) -> tuple[np.ndarray, np.ndarray]:
    """Return the snapshots' directions and their intensities (m/s), rising."""
    directions = 2.0 * np.pi * np.arange(options.basis.directions) / options.basis.directions
    if options.closure == "proportional":  # one Reynolds number for all
        return directions, np.array([options.reference_intensity])
    levels = np.arange(1, options.basis.levels + 1) / options.basis.levels
    return directions, options.basis.max_intensity * levels**2


def snapshots(solver: WindSolver) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return R and d (s, 2), velocities (2 v, s) and scaled derivatives (2 v, k) of the winds on the grid.

    A derivative is scaled by half a cell of the grid: how far a wind asked for is from the next snapshot. A wind that
    cannot be solved ends its direction's row, with a line in the log.
    """
    from tqdm import tqdm

    from dafw.plugins.models.dispersion.wind import WindError

    directions, intensities = grid(solver.options)
    aside = np.pi / len(directions)
    beyond = 0.0
    parameters, winds, derivatives = [], [], []
    for direction in tqdm(directions, desc="winds for the reduced basis", disable=None, file=sys.stderr):
        start = None
        for intensity in intensities:
            try:
                found = solver.solve(intensity, direction, start)
            except WindError as error:
                log.info("reduced basis: %s", error)
                break
            start = found.unit
            reynolds = solver.reynolds(intensity)
            if len(intensities) > 1:
                beyond = np.sqrt(reynolds * solver.reynolds(intensities[-1])) / len(intensities)
            parameters.append((reynolds, direction))
            winds.append(solver.problem.velocity(start))
            by_reynolds, by_direction = solver.derivatives(found)
            derivatives += [beyond * by_reynolds, aside * by_direction]
    return np.array(parameters), np.stack(winds, axis=1), np.stack(derivatives, axis=1)


def orthonormal(space: VelocitySpace, vectors: np.ndarray, modes: int) -> np.ndarray:
    """Return the leading ``modes`` of vectors (2 v, k) in the inner product a, orthonormal to round-off."""
    gram = vectors.T @ (space.dirichlet @ vectors)
    energies, weights = np.linalg.eigh(gram)
    order = np.argsort(energies)[::-1][:modes]
    order = order[energies[order] > NEGLIGIBLE * energies.sum()]
    leading = vectors @ (weights[:, order] / np.sqrt(energies[order]))
    for _ in range(2):  # the first pass leaves what the squared condition number of the Gram matrix spoilt
        factor = np.linalg.cholesky(leading.T @ (space.dirichlet @ leading))
        leading = np.linalg.solve(factor, leading.T).T
    return np.ascontiguousarray(leading)


def build(solver: WindSolver) -> ReducedBasis:
    """Solve the winds of the grid and project: some minutes on a large mesh."""
    directions, intensities = grid(solver.options)
    log.info("reduced basis: solving %d winds", directions.size * intensities.size)
    parameters, winds, derivatives = snapshots(solver)
    space = VelocitySpace(solver.problem, solver.boundary)
    inner = in_space(space, winds)
    modes = orthonormal(
        space, np.concatenate([inner, in_space(space, derivatives)], axis=1), solver.options.basis.modes
    )
    log.info("reduced basis: projecting on %d modes", modes.shape[1])
    return project(space, modes, parameters, modes.T @ (space.dirichlet @ inner))


def enrich(solver: WindSolver, basis: ReducedBasis, parameters: np.ndarray, winds: np.ndarray) -> ReducedBasis:
    """Return a basis that holds these winds (2 v, k) of R and d (k, 2), too."""
    log.info("reduced basis: taking in %d more winds", len(parameters))
    space = VelocitySpace(solver.problem, solver.boundary)
    modes = basis.velocities[:, 2:]
    inner = in_space(space, winds)
    new = inner - modes @ (modes.T @ (space.dirichlet @ inner))
    new -= modes @ (modes.T @ (space.dirichlet @ new))
    new = orthonormal(space, new, new.shape[1])
    both = np.concatenate([modes, new], axis=1)
    known = np.pad(basis.coefficients, ((0, 0), (0, new.shape[1])))
    coefficients = np.concatenate([known.T, both.T @ (space.dirichlet @ inner)], axis=1)
    return project(space, both, np.concatenate([basis.parameters, parameters]), coefficients)


def in_space(space: VelocitySpace, velocities: np.ndarray) -> np.ndarray:
    """Return velocities (2 v, k) less their Stokes flows, which are orthogonal to V."""
    product = space.lifts.T @ (space.dirichlet @ np.concatenate([space.lifts, velocities], axis=1))
    return velocities - space.lifts @ np.linalg.solve(product[:, :2], product[:, 2:])


def project(space: VelocitySpace, modes: np.ndarray, parameters: np.ndarray, coefficients: np.ndarray) -> ReducedBasis:
    """Return the basis with modes (2 v, r), orthonormal in a, and coefficients (r, s) of the snapshots."""
    rng = np.random.default_rng(SEED)
    functionals = np.stack([space.riesz(space.noise(rng)) for _ in range(FUNCTIONALS)], axis=1)
    velocities = np.concatenate([space.lifts, modes], axis=1)
    n, r = velocities.shape[1], modes.shape[1]
    tested = space.by_component(np.concatenate([modes, functionals], axis=1))
    tests = np.ascontiguousarray(tested.reshape(space.size, -1).T)
    carried = np.ascontiguousarray(space.by_component(velocities))
    tensor = np.empty((r + FUNCTIONALS, n, n))
    for j in range(n):
        tensor[:, j] = tests @ (space.convection(velocities[:, j]) @ carried).reshape(space.size, n)
    tensor = 0.5 * (tensor + tensor.transpose(0, 2, 1))
    first, second = np.triu_indices(n)
    linear = functionals.T @ (space.dirichlet @ velocities)
    return ReducedBasis(
        velocities=np.ascontiguousarray(velocities),
        quadratic=tensor[:r],
        gram=velocities.T @ (space.mass @ velocities),
        functionals=linear,
        functionals_quadratic=np.ascontiguousarray(tensor[r:, first, second]),
        parameters=parameters,
        coefficients=np.ascontiguousarray(coefficients.T),
    )
