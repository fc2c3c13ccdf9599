"""Flow around a cylinder, benchmark 2D-1 of Schaefer and Turek (1996), by the study's own discretisation and solver.

A channel of 2.2 m x 0.41 m, a cylinder of 0.1 m about (0.2, 0.2), a parabolic inflow of at most 0.3 m/s, a do-nothing
outlet, 1e-3 m^2/s: Reynolds number 20. Schaefer and Turek, Notes on Numerical Fluid Mechanics 48 (1996),
doi:10.1007/978-3-322-89849-4_39; the reference values in all digits are those of the FeatFlow collection (Nabh 1998).
"""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Any

import numpy as np

from benchmarks import Measurement, benchmark

VISCOSITY = 1e-3
HEIGHT, LENGTH, CENTRE, RADIUS = 0.41, 2.2, (0.2, 0.2), 0.05


@dataclass(frozen=True)
class Forces:
    """Drag and lift coefficient, and the pressure in front of the cylinder minus that behind it (density 1)."""

    drag: float
    lift: float
    pressure_difference: float


REFERENCE = Forces(5.57953523384, 0.010618948146, 0.11752016697)


def channel(refinement: int) -> Any:
    """Return the mesh, straight triangles whose sides halve with every refinement."""
    import dolfinx_solver  # noqa: F401  (before dolfinx)

    # isort: split
    import gmsh
    from dolfinx.io import gmsh as dolfinx_gmsh
    from mpi4py import MPI

    around, far = 0.02 / 2**refinement, 0.08 / 2**refinement
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        corners = [(0.0, 0.0), (LENGTH, 0.0), (LENGTH, HEIGHT), (0.0, HEIGHT)]
        angles = 2.0 * np.pi * np.arange(16 * 2**refinement) / (16 * 2**refinement)
        circle = [(CENTRE[0] + RADIUS * np.cos(a), CENTRE[1] + RADIUS * np.sin(a)) for a in angles]
        loops = []
        for ring, size in ((corners, far), (circle, around)):
            points = [gmsh.model.geo.addPoint(x, y, 0.0, size) for x, y in ring]
            lines = [gmsh.model.geo.addLine(a, b) for a, b in zip(points, points[1:] + points[:1], strict=True)]
            loops.append(gmsh.model.geo.addCurveLoop(lines))
        surface = gmsh.model.geo.addPlaneSurface(loops)
        gmsh.model.geo.synchronize()
        gmsh.model.addPhysicalGroup(2, [surface], 1)
        gmsh.model.mesh.generate(2)
        return dolfinx_gmsh.model_to_mesh(gmsh.model, MPI.COMM_SELF, 0, gdim=2).mesh
    finally:
        gmsh.finalize()


def forces(mesh: Any) -> tuple[Forces, int]:
    """Return the forces of the flow on the cylinder, and the number of unknowns."""
    from dafw.plugins.models.dispersion.fem.newton import NewtonSolver
    from dafw.plugins.models.dispersion.fem.taylor_hood import TaylorHood

    # isort: split
    from dolfinx import fem
    from dolfinx.mesh import exterior_facet_indices

    problem = TaylorHood(mesh)
    mesh.topology.create_connectivity(1, 2)
    nodes = fem.locate_dofs_topological(problem.velocity_space, 1, exterior_facet_indices(mesh.topology))
    x, y = problem.velocity_space.tabulate_dof_coordinates()[nodes, :2].T
    held = nodes[(x < LENGTH - 1e-9) | (y < 1e-9) | (y > HEIGHT - 1e-9)]
    cylinder = nodes[np.hypot(x - CENTRE[0], y - CENTRE[1]) < RADIUS + 1e-9]
    inlet = nodes[x < 1e-9]
    components = problem.velocity_dofs.reshape(-1, 2)
    fixed, start = np.zeros(problem.unknowns, dtype=bool), np.zeros(problem.unknowns)
    fixed[components[held]] = True
    height = y[x < 1e-9]
    start[components[inlet, 0]] = 4.0 * 0.3 * height * (HEIGHT - height) / HEIGHT**2
    reynolds = 1.0 / VISCOSITY  # per m/s: the unknowns are the velocity itself and the pressure over the viscosity
    found = NewtonSolver(problem).solve(start, reynolds, fixed, 1e-10, 20).unknowns
    # The force is the residual of the equations that the boundary condition at the cylinder replaced: Babuska & Miller
    # (1984).
    force = -VISCOSITY * problem.residual(found, reynolds)[components[cylinder]].sum(axis=0)
    drag, lift = 2.0 * force / (0.2**2 * 2.0 * RADIUS)
    places = problem.pressure_space.tabulate_dof_coordinates()[:, :2]
    ends = [
        np.argmin(np.hypot(*(places - [CENTRE[0] + side * RADIUS, CENTRE[1]]).T)) for side in (-1.0, 1.0)
    ]  # both are corners of the polygon
    front, behind = VISCOSITY * found[problem.pressure_dofs[ends]]
    return Forces(float(drag), float(lift), float(front - behind)), problem.unknowns


@benchmark("wind.cylinder_drag_error")
def cylinder_drag_error(short: bool) -> Measurement:
    """Relative error of the drag on the finest of several meshes; the detail has the results on all of them."""
    table = []
    for refinement in range(1 if short else 5):
        found, unknowns = forces(channel(refinement))
        table.append([unknowns, *astuple(found)])
    error = abs(table[-1][1] / REFERENCE.drag - 1.0)
    return Measurement(
        float(error), "relative", 1e-3, {"unknowns_drag_lift_pressure": table, "reference": astuple(REFERENCE)}
    )
