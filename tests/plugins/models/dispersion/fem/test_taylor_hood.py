"""The discrete Navier-Stokes equations: exact flows, a manufactured solution, the Jacobian."""

import dolfinx_solver  # noqa: F401  (before dolfinx)

# isort: split
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import exterior_facet_indices
from flow_meshes import rectangle
from scipy.sparse import csr_matrix

from dafw.plugins.models.dispersion.fem.newton import NewtonSolver
from dafw.plugins.models.dispersion.fem.taylor_hood import TaylorHood


def solve_with_exact_boundary(problem, velocity, pressure, reynolds, load=None, free=None):
    """The discrete solution with the velocity given on the whole boundary except at points that ``free`` marks."""
    exact = np.zeros(problem.unknowns)
    for space, dofs, function in (
        (problem.velocity_space, problem.velocity_dofs, velocity),
        (problem.pressure_space, problem.pressure_dofs, pressure),
    ):
        interpolant = fem.Function(space)
        interpolant.interpolate(function)
        exact[dofs] = interpolant.x.array
    mesh = problem.space.mesh
    mesh.topology.create_connectivity(1, 2)
    nodes = fem.locate_dofs_topological(problem.velocity_space, 1, exterior_facet_indices(mesh.topology))
    fixed = np.zeros(problem.unknowns, dtype=bool)
    if free is None:
        fixed[problem.pressure_dofs[0]] = True
    else:
        points = problem.velocity_space.tabulate_dof_coordinates()[nodes]
        nodes = nodes[~free(points.T)]
    fixed[problem.velocity_dofs.reshape(-1, 2)[nodes]] = True
    start = np.where(fixed, exact, 0.0)
    found = NewtonSolver(problem).solve(start, reynolds, fixed, 1e-11, 20, load)
    assert found.converged
    return found.unknowns, exact


def l2_errors(cells):
    """L2 errors of velocity and pressure for a manufactured flow at unit Reynolds number 10 on a unit square."""
    problem = TaylorHood(rectangle(cells, cells).mesh)
    x = ufl.SpatialCoordinate(problem.space.mesh)
    stream = ufl.sin(2 * x[0]) * ufl.cos(3 * x[1]) + x[0] ** 2 * x[1]
    velocity = ufl.as_vector((stream.dx(1), -stream.dx(0)))
    pressure = ufl.cos(2 * x[0] + x[1])
    reynolds = 10.0
    force = -ufl.div(ufl.grad(velocity)) + reynolds * ufl.dot(ufl.grad(velocity), velocity) + ufl.grad(pressure)
    v, _ = ufl.TestFunctions(problem.space)
    load = fem.assemble_vector(fem.form(ufl.inner(force, v) * ufl.dx(metadata={"quadrature_degree": 8}))).array

    def exact_velocity(p):
        a, b = 2 * p[0], 3 * p[1]
        return np.array([-3 * np.sin(a) * np.sin(b) + p[0] ** 2, -2 * np.cos(a) * np.cos(b) - 2 * p[0] * p[1]])

    unknowns, _ = solve_with_exact_boundary(
        problem, exact_velocity, lambda p: np.cos(2 * p[0] + p[1]), reynolds, load=load
    )
    found = fem.Function(problem.space)
    found.x.array[:] = unknowns
    w, q = ufl.split(found)
    dx = ufl.dx(metadata={"quadrature_degree": 8})
    offset = fem.assemble_scalar(fem.form((q - pressure) * dx))  # a pressure is known up to a constant; the area is 1
    return [
        np.sqrt(fem.assemble_scalar(fem.form(ufl.inner(error, error) * dx)))
        for error in (w - velocity, q - pressure - offset)
    ]


def test_manufactured_solution_converges_with_orders_three_and_two():
    coarse, fine = l2_errors(8), l2_errors(16)
    velocity_order, pressure_order = np.log2(coarse) - np.log2(fine)
    assert velocity_order >= 2.9
    assert pressure_order >= 1.9


@pytest.mark.parametrize("outlet", [None, lambda p: (p[0] > 3 - 1e-9) & (p[1] > 1e-9) & (p[1] < 1 - 1e-9)])
def test_poiseuille_flow_is_exact_with_and_without_a_do_nothing_outlet(outlet):
    problem = TaylorHood(rectangle(6, 3, (3.0, 1.0)).mesh)
    found, exact = solve_with_exact_boundary(
        problem,
        lambda p: np.array([p[1] * (1 - p[1]), 0 * p[0]]),
        lambda p: 2 * (3 - p[0]),
        reynolds=50.0,
        free=outlet,
    )
    if outlet is None:  # the pressure was fixed at one node, to its exact value
        assert found[problem.pressure_dofs[0]] == exact[problem.pressure_dofs[0]]
    np.testing.assert_allclose(found, exact, atol=1e-9)


def test_couette_flow_is_exact():
    problem = TaylorHood(rectangle(6, 3, (3.0, 1.0)).mesh)
    found, exact = solve_with_exact_boundary(
        problem, lambda p: np.array([p[1], 0 * p[0]]), lambda p: 0 * p[0], reynolds=50.0
    )
    np.testing.assert_allclose(found, exact, atol=1e-9)


def test_jacobian_is_the_derivative_of_the_residual():
    problem = TaylorHood(rectangle(3, 3).mesh)
    rng = np.random.default_rng(0)
    x, d = rng.normal(size=(2, problem.unknowns))
    jacobian = csr_matrix((problem.jacobian(x, 7.0), problem.sparsity.indices, problem.sparsity.indptr))
    # central differences are exact for a quadratic
    difference = (problem.residual(x + d, 7.0) - problem.residual(x - d, 7.0)) / 2
    np.testing.assert_allclose(jacobian @ d, difference, atol=1e-10)
