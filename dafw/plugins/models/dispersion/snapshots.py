"""The winds that a reduced basis is made from: a row of intensities for each direction, rows side by side.

A row is solved upwards, each wind from the one before; it depends on nothing else, so that where it is solved changes
no bit. Each wind brings along its derivatives to the unit Reynolds number R and to the direction d, which cost two
triangular solves with a factorisation that is there.
"""

from __future__ import annotations

import logging
import pickle
import sys
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dafw.core.workers import Outcome, outcome, share_out, spare_cores

if TYPE_CHECKING:
    from dafw.plugins.models.dispersion.wind import WindOptions, WindSolver

log = logging.getLogger(__name__)

SMALL = 1_000_000
"""Unknowns times winds, some ten seconds of work, up to which starting other processes is not worth its time."""


@dataclass(frozen=True)
class Snapshots:
    """Winds: R and d (s, 2), velocities (2 v, s) and scaled derivatives (2 v, 2 s)."""

    parameters: np.ndarray
    winds: np.ndarray
    derivatives: np.ndarray


def grid(options: WindOptions) -> tuple[np.ndarray, np.ndarray]:
    """Return the snapshots' directions and their intensities (m/s), rising; most where most winds are, near calm."""
    directions = 2.0 * np.pi * np.arange(options.basis.directions) / options.basis.directions
    if options.closure == "proportional":  # one Reynolds number for all
        return directions, np.array([options.reference_intensity])
    levels = np.arange(1, options.basis.levels + 1) / options.basis.levels
    return directions, options.basis.max_intensity * levels**2


def snapshots(solver: WindSolver, mesh_file: Path | None) -> Snapshots:
    """Return the winds of the grid, solved by as many processes as there are cores; some minutes on a large mesh.

    Other processes read the mesh from its file; where it has none, or there is little to do, all is solved in this one.
    A wind that cannot be solved ends its row, with a line in the log. Raises WindError where there is none at all.
    """
    from tqdm import tqdm

    from dafw.plugins.models.dispersion.wind import WindError

    directions, intensities = grid(solver.options)
    winds = directions.size * intensities.size
    alone = mesh_file is None or winds * solver.problem.unknowns <= SMALL
    workers = 1 if alone else min(spare_cores(), directions.size)
    log.info("reduced basis: solving %d winds, processes: %d", winds, workers)
    found: dict[int, Snapshots] = {}
    with (
        closing(_rows(solver, mesh_file, directions, workers)) as rows,
        tqdm(total=winds, desc="winds for the reduced basis", unit="wind", disable=None, file=sys.stderr) as bar,
    ):
        for number, one in rows:
            found[number] = one
            bar.update(intensities.size)
    together = [found[number] for number in range(directions.size)]
    if not any(len(one.parameters) for one in together):
        raise WindError(f"reduced basis: none of its {winds} winds can be solved; the log says why")
    return Snapshots(
        np.concatenate([one.parameters for one in together]),
        np.ascontiguousarray(np.concatenate([one.winds for one in together], axis=1)),
        np.ascontiguousarray(np.concatenate([one.derivatives for one in together], axis=1)),
    )


def _rows(
    solver: WindSolver, mesh_file: Path | None, directions: np.ndarray, workers: int
) -> Generator[tuple[int, Snapshots]]:
    """Yield number and winds of every row, as they are done."""
    if workers == 1:
        yield from ((number, row(solver, direction)) for number, direction in enumerate(directions))
    else:
        tasks = [(mesh_file, solver.options, direction) for direction in directions]
        yield from share_out(_row_elsewhere, tasks, workers, "reduced basis")


def row(solver: WindSolver, direction: float) -> Snapshots:
    """Return the winds of one direction.

    A derivative is scaled by half a cell of the grid: how far a wind asked for is from the next snapshot.
    """
    from dafw.plugins.models.dispersion.wind import WindError

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
        if solver.options.closure == "constant":  # otherwise there is one R, and nothing beyond it
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


_SOLVERS: dict[bytes, WindSolver] = {}
"""That of a worker process, which solves one row after the other on the same mesh."""


def _row_elsewhere(mesh_file: Path, options: WindOptions, direction: float) -> Outcome:
    """Solve a row in a worker process; the value is its Snapshots."""

    def solved() -> Snapshots:
        from dafw.plugins.models.dispersion.mesh import load
        from dafw.plugins.models.dispersion.wind import WindSolver

        name = pickle.dumps((mesh_file, options))
        if name not in _SOLVERS:
            _SOLVERS.clear()
            _SOLVERS[name] = WindSolver(load(mesh_file), options)
        return row(_SOLVERS[name], direction)

    return outcome("reduced basis: a worker", solved)
