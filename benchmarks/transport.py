"""The transport: a step in winds of the reduced basis against the paper's literal step. See docs/fast-winds.md."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks import Measurement, benchmark
from benchmarks.wind import UNSEEN, case, draws, timed
from dafw.plugins.models.dispersion.mesh.tagged import TaggedMesh
from dafw.plugins.models.dispersion.transport.options import TransportOptions
from dafw.plugins.models.dispersion.transport.system import TransportSystem
from dafw.plugins.models.dispersion.transport.transport import Transport


@benchmark("ad.step_over_scratch")
def step_over_scratch(short: bool) -> Measurement:
    """Time of a member's step over that of the paper's literal step in the same wind; every fourth wind is new.

    The literal step assembles all forms and solves with ILU and BiCGStab from zero. A member of the recorded run had a
    new wind in every fourth step: 250 times in 1000 steps. The step in a new wind includes its matrix and its
    preconditioner. Neither side includes solving for the wind.
    """
    from dafw.plugins.models.dispersion.reduced_wind.advection import ReducedAdvection

    measured = case(short)
    transport = Transport(measured.tagged_mesh, TransportOptions(tolerance=1e-10), 1.0)
    advection = ReducedAdvection(transport, measured.reduced)
    scratch = FromScratch(measured.tagged_mesh, transport)
    places = measured.tagged_mesh.mesh.geometry.x[:, :2]
    cloud = np.exp(-((scratch.coordinates - places.mean(axis=0)) ** 2).sum(axis=1) / (2.0 * 60.0**2))
    rows = []

    def in_new_wind(unit: np.ndarray, intensity: float) -> tuple[TransportSystem, np.ndarray]:
        system = transport.system_of(advection.matrix(unit, intensity), member)
        return system, system.step(cloud)

    member = transport.system(transport.uniform_velocity(1.0, 0.0))  # every member has a system from its last wind
    for intensity, direction in draws(3 if short else 31, 8.0):
        solution, solve = timed(measured.reduced.solve, intensity, direction)
        wind = measured.reduced.velocity(solution)
        (system, first), new = timed(in_new_wind, solution.unit, intensity)
        second, dear = timed(scratch.step, wind, cloud)
        _, kept = timed(system.step, first)
        rows.append((solve, new, kept, dear, np.abs(first - second).max() / np.abs(second).max()))
    solve, new, kept, dear, differences = np.array(rows).T
    detail = {
        "largest_difference": float(differences.max()),
        "with_a_new_wind": round(float(np.median(new / dear)), 3),
        "with_a_new_wind_and_its_solve": round(float(np.median((solve + new) / dear)), 3),
        "wind_kept": round(float(np.median(kept / dear)), 3),
        "median_ms_solve_new_kept_scratch": (1e3 * np.median([solve, new, kept, dear], axis=1)).round(2).tolist(),
    }
    return Measurement(float(np.median((new + 3.0 * kept) / 4.0 / dear)), "of the time from scratch", 0.25, detail)


@benchmark("ad.two_precisions")
def two_precisions(short: bool) -> Measurement:
    """Change of a step of two clouds by single precision for small modes, relative to the largest concentration."""
    from dafw.plugins.models.dispersion.reduced_wind.advection import ReducedAdvection

    measured = case(short)
    transport = Transport(measured.tagged_mesh, TransportOptions(tolerance=1e-13), 1.0)
    quick = ReducedAdvection(transport, measured.reduced)
    exact = ReducedAdvection(transport, measured.reduced, accepted=0.0)
    distances = ((transport.matrices.places - transport.matrices.places.mean(axis=0)) ** 2).sum(axis=1)
    clouds = [np.exp(-(distances - distances.min()) / (2.0 * radius**2)) for radius in (10.0, 60.0)]
    system, differences = None, []
    for intensity, direction in draws(4 if short else UNSEEN, measured.options.basis.max_intensity):
        unit = measured.reduced.solve(intensity, direction).unit
        if not quick.holds(unit):
            continue
        after = []
        for advection in (exact, quick):
            system = transport.system_of(advection.matrix(unit, intensity), system)
            after.append(np.array([system.step(cloud) for cloud in clouds]))
        differences.append((np.abs(after[1] - after[0]).max(axis=1) / after[0].max(axis=1)).max())
    detail = {"winds": len(differences), "median": float(np.median(differences)), "in_double": quick.leading}
    return Measurement(float(np.max(differences)), "of the largest concentration", 1e-8, detail)


@benchmark("ad.fct_over_galerkin")
def fct_over_galerkin(short: bool) -> Measurement:
    """A flux-corrected step over one of Galerkin's in the same kept wind, open boundary; and of a new wind."""
    measured = case(short)
    schemes = ("galerkin", "fct")
    transports = [
        Transport(measured.tagged_mesh, TransportOptions(scheme=name, outflow="open"), 1.0) for name in schemes
    ]
    places = transports[0].matrices.places
    cloud = np.exp(-((places - places.mean(axis=0)) ** 2).sum(axis=1) / (2.0 * 30.0**2))
    rows, systems = [], [one.system(one.uniform_velocity(1.0, 0.0)) for one in transports]
    for intensity, direction in draws(3 if short else 31, 8.0):
        solution = measured.reduced.solve(intensity, direction)
        advection = transports[0].advection(measured.reduced.velocity(solution))
        row = []
        for transport, system in zip(transports, systems, strict=True):
            _, new = timed(transport.system_of, advection, system)
            after = system.step(cloud)
            kept = [timed(system.step, after)[1] for _ in range(1 if short else 5)]
            row.append((new, float(np.median(kept))))
        rows.append(row)
    (new, kept), (new_fct, kept_fct) = np.array(rows).transpose(1, 2, 0)
    detail = {
        "nodes": transports[0].matrices.nodes,
        "new_wind": round(float(np.median(new_fct / new)), 2),
        "median_ms_new_kept_galerkin": (1e3 * np.median([new, kept], axis=1)).round(2).tolist(),
        "median_ms_new_kept_fct": (1e3 * np.median([new_fct, kept_fct], axis=1)).round(2).tolist(),
    }
    return Measurement(float(np.median(kept_fct / kept)), "of the time of Galerkin's step", 3.0, detail)


class FromScratch:
    """The paper's literal step: all forms assembled, ILU, BiCGStab from zero."""

    def __init__(self, tagged_mesh: TaggedMesh, transport: Any):
        import dolfinx_solver  # noqa: F401  (before dolfinx)

        # isort: split
        import ufl
        from dolfinx import fem

        self._options, mesh = transport.matrices.options, tagged_mesh.mesh
        space = fem.functionspace(mesh, ("Lagrange", 1))
        self.coordinates = space.tabulate_dof_coordinates()[:, :2]
        self._wind = fem.Function(fem.functionspace(mesh, ("Lagrange", 2, (2,))))
        self._before = fem.Function(space)
        c, v, dt = ufl.TrialFunction(space), ufl.TestFunction(space), transport.matrices.dt
        left = c * v / dt + transport.matrices.options.diffusion * ufl.inner(ufl.grad(c), ufl.grad(v))
        self._left = fem.form((left + ufl.dot(self._wind, ufl.grad(c)) * v) * ufl.dx)
        self._right = fem.form(self._before / dt * v * ufl.dx)
        self._boundary = fem.dirichletbc(0.0, transport.matrices.outer, space)

    def step(self, velocity: Any, concentration: np.ndarray) -> np.ndarray:
        """Return the concentration (nodes,) a step later in a wind that is a DOLFINx function in m/s."""
        from dolfinx import fem
        from dolfinx.fem import petsc
        from petsc4py import PETSc

        self._wind.interpolate(velocity)
        self._before.x.array[:] = concentration
        matrix = petsc.assemble_matrix(self._left, bcs=[self._boundary])
        matrix.assemble()
        right = petsc.assemble_vector(self._right)
        petsc.set_bc(right, [self._boundary])
        solver: Any = PETSc.KSP().create(PETSc.COMM_SELF)
        solver.setOperators(matrix)
        solver.setType("bcgs")
        solver.getPC().setType("ilu")
        solver.setTolerances(rtol=self._options.tolerance, max_it=self._options.max_iterations)
        after = fem.Function(self._before.function_space)
        solver.solve(right, after.x.petsc_vec)
        return np.asarray(after.x.array).copy()
