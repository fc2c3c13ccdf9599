"""The winds that a reduced basis is made from: for each direction a row of rising intensities.

A row is solved upwards, each wind from the one before. It depends on nothing else, so its bits are the same in whatever
process it is solved. Each wind comes with its derivatives with respect to the unit Reynolds number R and the direction
d. They cost two triangular solves with the factorisation of the last Newton step.
"""

from __future__ import annotations

import logging
import pickle
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from dafw.core.progress import long_task
from dafw.core.workers import Outcome, outcome, run_tasks, spare_cores
from dafw.plugins.models.dispersion.mesh.load import load
from dafw.plugins.models.dispersion.wind.options import WindOptions
from dafw.plugins.models.dispersion.wind.solution import WindError
from dafw.plugins.models.dispersion.wind.solver import WindSolver

log = logging.getLogger(__name__)

SMALL = 1_000_000
"""Unknowns times winds up to which all winds are solved in this process.

That takes some ten seconds; starting worker processes would cost more than it saves.
"""


@dataclass(frozen=True)
class Snapshots:
    """Winds and their derivatives.

    Attributes:
        parameters: (s, 2) unit Reynolds number in 1/m and direction in radians of every wind.
        winds: (2 m, s) velocities of the unit winds.
        derivatives: (2 m, 2 s) scaled derivatives with respect to R and d.
    """

    parameters: np.ndarray
    winds: np.ndarray
    derivatives: np.ndarray


def grid(options: WindOptions) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions in radians and the rising intensities in m/s; the intensities are denser towards calm."""
    directions = 2.0 * np.pi * np.arange(options.basis.directions) / options.basis.directions
    if options.closure == "proportional":  # all intensities have the same Reynolds number
        return directions, np.array([options.reference_intensity])
    levels = np.arange(1, options.basis.levels + 1) / options.basis.levels
    return directions, options.basis.max_intensity * levels**2


def snapshots(solver: WindSolver, mesh_file: Path | None) -> Snapshots:
    """Return the winds of the grid; some minutes on a large mesh.

    As many worker processes solve them as there are cores. They read the mesh from its file. Without a file, or if
    there is little work, all winds are solved in this process. A wind that cannot be solved ends its row, with a line
    in the log. Raises WindError if no wind at all can be solved.
    """
    directions, intensities = grid(solver.options)
    winds = directions.size * intensities.size
    alone = mesh_file is None or winds * solver.problem.unknowns <= SMALL
    workers = 1 if alone else min(spare_cores(), directions.size)
    found: dict[int, Snapshots] = {}
    with (
        closing(_rows(solver, mesh_file, directions, workers)) as rows,
        long_task(f"reduced basis: solving {winds} winds, processes: {workers}", winds, "wind") as bar,
    ):
        for number, one in rows:
            found[number] = one
            bar.update(intensities.size)
    in_order = [found[number] for number in range(directions.size)]
    if not any(len(one.parameters) for one in in_order):
        raise WindError(f"reduced basis: none of its {winds} winds can be solved; the log says why")
    return Snapshots(
        np.concatenate([one.parameters for one in in_order]),
        np.ascontiguousarray(np.concatenate([one.winds for one in in_order], axis=1)),
        np.ascontiguousarray(np.concatenate([one.derivatives for one in in_order], axis=1)),
    )


def _rows(
    solver: WindSolver, mesh_file: Path | None, directions: np.ndarray, workers: int
) -> Generator[tuple[int, Snapshots]]:
    """Yield the number and the winds of every row as soon as it is solved."""
    if workers == 1:
        yield from ((number, row(solver, direction)) for number, direction in enumerate(directions))
    else:
        options = pickle.dumps(solver.options)
        tasks = [(mesh_file, options, direction) for direction in directions]
        yield from run_tasks(_row_in_worker, tasks, workers, "reduced basis")


def row(solver: WindSolver, direction: float) -> Snapshots:
    """Return the winds of one direction, in radians.

    A derivative is scaled by half the distance to the next snapshot: the farthest that a wind is from a snapshot.
    """
    directions, intensities = grid(solver.options)
    aside = np.pi / len(directions)
    start, beyond = None, 0.0
    parameters, winds, derivatives = [], [], []
    for intensity in intensities:
        try:
            found = solver.solve(intensity, direction, start)
        except WindError as error:
            log.info("reduced basis: %s", error)
            break
        start = found.unit
        reynolds = solver.reynolds(intensity)
        if solver.options.closure == "constant":  # with the proportional closure there is only one R
            beyond = np.sqrt(reynolds * solver.reynolds(intensities[-1])) / len(intensities)
        parameters.append((reynolds, direction))
        winds.append(solver.problem.velocity(start))
        by_reynolds, by_direction = solver.derivatives(found)
        derivatives += [beyond * by_reynolds, aside * by_direction]
    size = solver.problem.velocity_dofs.size
    return Snapshots(
        np.array(parameters).reshape(-1, 2),
        np.array(winds).reshape(-1, size).T,
        np.array(derivatives).reshape(-1, size).T,
    )


def _row_in_worker(mesh_file: Path, options: bytes, direction: float) -> Outcome:
    """Solve a row in a worker process; the value of the outcome is its Snapshots."""
    return outcome("reduced basis: a worker", lambda: row(_worker_solver(mesh_file, options), direction))


@lru_cache(maxsize=1)
def _worker_solver(mesh_file: Path, options: bytes) -> WindSolver:
    """Return the solver of a worker process, which it keeps for all its rows; the process ends with the last row."""
    return WindSolver(load(mesh_file), pickle.loads(options))
