"""Results of ranks on a mesh that is divided among them. test_mpi.py runs this by mpiexec, and on a single rank.

python divided_mesh.py FILE OPTIONS        OPTIONS: those of a model ad_ins, JSON; FILE: .npz
"""

import json
import sys
from pathlib import Path

import numpy as np

from dafw.core.errors import DafwError
from dafw.core.options import build
from dafw.core.rng import Streams
from dafw.plugins.models.dispersion.mesh.generate import generate
from dafw.plugins.models.dispersion.mesh.load import load
from dafw.plugins.models.dispersion.model_ins import AdvectionDiffusionINS
from dafw.plugins.models.dispersion.transport.options import TransportOptions
from dafw.plugins.models.dispersion.transport.transport import Transport
from dafw.plugins.models.dispersion.wind.options import WindOptions
from dafw.plugins.models.dispersion.wind.solver import WindSolver
from dafw.plugins.models.dispersion.wind_solvers import wind_solver

TOLERANCE = 1e-11
CENTRE = np.array([30.0, 5.0])


def gathered(comm, space, values):
    """Return places (m, 2) and values (m, k) of all ranks: of the dofs of a space that each rank owns."""
    places = space.tabulate_dof_coordinates()[: space.dofmap.index_map.size_local, :2]
    rows = np.column_stack([places, values.reshape(len(places), -1)])
    return np.concatenate(comm.allgather(rows))


def winds(comm, tagged, boundary):
    """A wind from Stokes flow, and another from the first: velocities, pressures, and the last wind as a function."""
    solver = WindSolver(tagged, WindOptions(viscosity=10.0, tolerance=TOLERANCE, boundary=boundary))
    problem, found, unit = solver.problem, {}, None
    for name, intensity, direction in (("first", 5.0, 0.5), ("second", 6.0, 1.2)):
        unit = solver.solve(intensity, direction, unit).unit
        velocity, pressure = problem.velocity(unit), unit[problem.pressure_dofs]
        found[f"velocity {boundary} {name}"] = gathered(comm, problem.velocity_space, velocity)
        found[f"pressure {boundary} {name}"] = gathered(comm, problem.pressure_space, pressure)
    return found, solver.velocity(unit, 6.0)


def clouds(comm, tagged, scheme, flow):
    """A Gaussian cloud after four steps with a source, in a wind around buildings and in a uniform wind."""
    transport = Transport(tagged, TransportOptions(scheme=scheme, tolerance=1e-13), 1.0)
    winds = {"flow": flow, "uniform": transport.uniform_velocity(4.0, 2.0)}
    winds["strong"] = transport.uniform_velocity(60.0, 2.0)
    strengths = {"flow": 1, "uniform": 0, "strong": 2}  # ILU(1), ILU(0), direct
    for wind, velocity in winds.items():
        cloud = np.exp(-((transport.matrices.places - CENTRE) ** 2).sum(axis=1) / 400.0)
        system, source = transport.system(velocity), 0.1 * cloud
        if scheme == "galerkin" and system.strength != strengths[wind]:
            raise ValueError(f"expected the strength {strengths[wind]} of the wind '{wind}', got {system.strength}")
        for _ in range(4):
            cloud = system.step(cloud, source)
        yield wind, np.concatenate(comm.allgather(np.column_stack([transport.matrices.places, cloud])))


def forecasts(comm, options):
    """Three members of a model stepped three times, and the winds in their memory, whole on every rank."""
    model = build(AdvectionDiffusionINS, options | {"noise": 0.1, "wind": {"tolerance": TOLERANCE}}, "model")
    if comm.size > 1:
        model.distribute(comm)
    streams = Streams(1)
    forecast = model.first_guess(3, streams.members("initial", 0))
    for cycle in range(3):
        forecast = model.forecast(forecast.ensemble, forecast.memory, streams.members("error", cycle))
    return {"members": forecast.ensemble.members, "units": forecast.memory["unit"]}


def failures(comm, tagged):
    """The error on each rank if something is wrong, in some cases on one rank alone."""

    def bad_start():
        solver = WindSolver(tagged, WindOptions())
        start = np.zeros(solver.unknowns)
        start[0] = np.nan if comm.rank == comm.size - 1 else 0.0
        solver.solve(1.0, 0.0, start)

    def too_few_steps():
        WindSolver(tagged, WindOptions(viscosity=0.1, max_iterations=1, max_steps=1)).solve(9.0, 1.0)

    attempts = {
        "no such file": lambda: load(Path("nowhere.msh"), comm),
        "reduced": lambda: wind_solver(tagged, WindOptions(solver="reduced")),
        "bad start": bad_start,
        "too few steps": too_few_steps,
    }
    for name, attempt in attempts.items():
        told = "nothing"
        try:
            attempt()
        except DafwError as error:
            told = f"{type(error).__name__}: {error}"
        yield f"failure {name}", np.array(comm.allgather(told))


def results(comm, options):
    """Return named arrays, the same on all ranks."""
    model = build(AdvectionDiffusionINS, options, "model")
    tagged = load(generate(model.ground, model.mesh), comm)
    found = {"nodes": np.array(comm.allgather(tagged.mesh.geometry.index_map().size_local))}
    for boundary in ("uniform", "outflow"):
        solved, flow = winds(comm, tagged, boundary)
        found |= solved
        for scheme in ("galerkin", "supg"):
            found |= {f"{scheme} {boundary} {wind}": cloud for wind, cloud in clouds(comm, tagged, scheme, flow)}
    found |= forecasts(comm, options)
    if comm.size > 1:
        found |= dict(failures(comm, tagged))
    bits = {name: array.tobytes() for name, array in found.items()}
    found["same on all ranks"] = np.array([other == bits for other in comm.allgather(bits)])
    return found


if __name__ == "__main__":
    from mpi4py import MPI

    calculated = results(MPI.COMM_WORLD, json.loads(sys.argv[2]))
    if MPI.COMM_WORLD.rank == 0:
        np.savez(sys.argv[1], **calculated)
