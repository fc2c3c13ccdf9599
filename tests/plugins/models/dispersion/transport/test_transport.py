"""Transport of the gas: manufactured solutions, exact moments, conservation, and refusal of what has not converged."""

import dolfinx_solver  # noqa: F401  (before dolfinx)

# isort: split
import numpy as np
import pytest
import ufl
from dolfinx import fem
from flow_meshes import rectangle
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import spsolve

from dafw.core.errors import ContractError, SolverError
from dafw.plugins.models.dispersion.mesh.tagged import OUTER
from dafw.plugins.models.dispersion.transport import system as system_module
from dafw.plugins.models.dispersion.transport.options import TransportOptions
from dafw.plugins.models.dispersion.transport.transport import Transport
from dafw.plugins.models.dispersion.wind.options import WindOptions
from dafw.plugins.models.dispersion.wind.solver import WindSolver

SCHEMES = pytest.mark.parametrize("scheme", ["galerkin", "supg"])


@pytest.fixture(scope="module")
def block():
    """100 m x 100 m with a building."""
    return rectangle(20, 20, (100.0, 100.0), [(30.0, 40.0, 50.0, 60.0)])


@pytest.fixture(scope="module")
def around_block(block):
    """The wind of 2 m/s towards the east around it."""
    solver = WindSolver(block, WindOptions(viscosity=10.0, tolerance=1e-12))
    return solver.velocity(solver.solve(2.0, 0.0))


def nodes_of(tagged):
    return fem.functionspace(tagged.mesh, ("Lagrange", 1)).tabulate_dof_coordinates()[:, :2]


def amount(tagged, nodal, weight=lambda x: 1.0):
    """The integral of a nodal concentration, weighted."""
    function = fem.Function(fem.functionspace(tagged.mesh, ("Lagrange", 1)))
    function.x.array[:] = nodal
    return fem.assemble_scalar(fem.form(weight(ufl.SpatialCoordinate(tagged.mesh)) * function * ufl.dx))


def bell(points, centre, radius):
    return np.exp(-((points - centre) ** 2).sum(axis=1) / (2 * radius**2))


def manufactured_error(scheme, cells, dt, steps, amplitude, rate):
    """L2 error of c = amplitude(t) sin(pi x) sin(pi y) in a vortex on the unit square after ``steps``."""
    tagged, diffusion = rectangle(cells, cells), 0.05
    transport = Transport(tagged, TransportOptions(diffusion=diffusion, scheme=scheme), dt)
    wind = fem.Function(fem.functionspace(tagged.mesh, ("Lagrange", 2, (2,))))
    wind.interpolate(lambda p: np.array([1 + p[0] ** 2, -2 * p[0] * p[1]]))
    x, y = nodes_of(tagged).T
    shape = np.sin(np.pi * x) * np.sin(np.pi * y)
    advected = np.pi * (
        (1 + x**2) * np.cos(np.pi * x) * np.sin(np.pi * y) - 2 * x * y * np.sin(np.pi * x) * np.cos(np.pi * y)
    )
    system, c = transport.system(wind), amplitude(0.0) * shape
    for step in range(1, steps + 1):
        t = step * dt
        c = system.step(c, rate(t) * shape + amplitude(t) * (advected + 2 * np.pi**2 * diffusion * shape))
    function = fem.Function(fem.functionspace(tagged.mesh, ("Lagrange", 1)))
    function.x.array[:] = c
    p = ufl.SpatialCoordinate(tagged.mesh)
    exact = amplitude(steps * dt) * ufl.sin(np.pi * p[0]) * ufl.sin(np.pi * p[1])
    return np.sqrt(fem.assemble_scalar(fem.form((function - exact) ** 2 * ufl.dx(metadata={"quadrature_degree": 6}))))


@SCHEMES
def test_manufactured_solution_converges_with_order_two_in_space(scheme):
    # backward Euler is exact for what grows linearly in time
    coarse, fine = (manufactured_error(scheme, cells, 0.1, 10, lambda t: 1 + t, lambda t: 1.0) for cells in (16, 32))
    assert np.log2(coarse / fine) >= 1.9


@SCHEMES
def test_manufactured_solution_converges_with_order_one_in_time(scheme):
    coarse, fine = (
        manufactured_error(scheme, 48, dt, round(0.5 / dt), lambda t: np.exp(4 * t), lambda t: 4 * np.exp(4 * t))
        for dt in (0.025, 0.0125)
    )
    assert np.log2(coarse / fine) >= 0.95


def test_moments_of_a_cloud_in_uniform_wind_are_those_of_backward_euler():
    """The mean travels at the wind; the variance grows by 2 (epsilon + u^2 dt / 2) dt along it, 2 epsilon dt across."""
    tagged, speed, diffusion, dt, steps = rectangle(40, 20, (200.0, 100.0)), 2.0, 0.7, 0.5, 12
    transport = Transport(tagged, TransportOptions(diffusion=diffusion), dt)
    system = transport.system(transport.uniform_velocity(speed, 0.0))
    c = bell(nodes_of(tagged), [80.0, 50.0], 8.0)

    def moments(nodal):
        mass = amount(tagged, nodal)
        mean = [amount(tagged, nodal, lambda x, i=i: x[i]) / mass for i in (0, 1)]
        return mass, *mean, *(amount(tagged, nodal, lambda x, i=i: (x[i] - mean[i]) ** 2) / mass for i in (0, 1))

    before = moments(c)
    for _ in range(steps):
        c = system.step(c)
    mass, x, y, along, across = np.array(moments(c)) - before
    time = steps * dt
    assert abs(mass) < 1e-6 * before[0]
    assert x == pytest.approx(speed * time, rel=1e-5)
    assert abs(y) < 1e-5
    assert along == pytest.approx(2 * (diffusion + speed**2 * dt / 2) * time, rel=1e-3)
    assert across == pytest.approx(2 * diffusion * time, rel=1e-3)


@SCHEMES
def test_gas_is_conserved_around_a_building_while_it_is_far_from_the_outer_boundary(scheme):
    site = rectangle(40, 40, (200.0, 200.0), [(90.0, 90.0, 110.0, 110.0)])
    solver = WindSolver(site, WindOptions(viscosity=10.0, tolerance=1e-12))
    wind = solver.velocity(solver.solve(2.0, 0.0))
    system = Transport(site, TransportOptions(diffusion=0.5, scheme=scheme), 0.5).system(wind)
    start = c = bell(nodes_of(site), [84.0, 102.0], 4.0)
    for _ in range(8):
        c = system.step(c)
    assert np.abs(c - start).max() > 0.1  # it moved
    assert amount(site, c) == pytest.approx(amount(site, start), rel=1e-8)


def test_step_solves_its_equations_to_round_off(block, around_block):
    """The sparse direct solution of the same matrices."""
    transport = Transport(block, TransportOptions(), 1.0)
    system = transport.system(around_block)
    c = bell(nodes_of(block), [27.0, 52.0], 4.0)
    indptr, indices, values = system._after.getValuesCSR()
    right = system._before @ c
    right[transport.matrices.outer] = 0.0
    direct = spsolve(csr_matrix((values, indices, indptr)).tocsc(), right)
    np.testing.assert_allclose(system.step(c), direct, atol=1e-11)


@SCHEMES
def test_result_depends_on_the_arguments_alone(block, around_block, scheme):
    def make():
        return Transport(block, TransportOptions(scheme=scheme), 1.0)

    transport = make()
    system = transport.system(around_block)
    c = bell(nodes_of(block), [70.0, 52.0], 8.0)
    first = system.step(c)
    other = transport.system(transport.uniform_velocity(9.0, 1.0))
    other.step(c[::-1].copy())
    system.step(first)
    assert np.array_equal(system.step(c), first)
    assert np.array_equal(transport.system(around_block).step(c), first)
    assert np.array_equal(make().system(around_block).step(c), first)


@SCHEMES
def test_a_system_made_over_has_the_bits_of_a_new_one(block, around_block, scheme):
    transport = Transport(block, TransportOptions(scheme=scheme), 1.0)
    c = bell(nodes_of(block), [70.0, 52.0], 8.0)
    system = transport.system(transport.uniform_velocity(9.0, 1.0))
    system.step(c)
    assert transport.system(around_block, system) is system
    assert np.array_equal(system.step(c), transport.system(around_block).step(c))


def test_uniform_velocity_is_the_wind_of_an_empty_site():
    empty = rectangle(10, 10, (100.0, 100.0))
    solver = WindSolver(empty, WindOptions(tolerance=1e-12))
    transport = Transport(empty, TransportOptions(), 1.0)
    c = bell(nodes_of(empty), [50.0, 50.0], 15.0)
    solved, given = solver.velocity(solver.solve(3.0, 2.0)), transport.uniform_velocity(3.0, 2.0)
    np.testing.assert_allclose(transport.system(solved).step(c), transport.system(given).step(c), atol=1e-9)


def test_outer_boundary_stays_clean_and_walls_do_not_absorb(block, around_block):
    transport = Transport(block, TransportOptions(), 1.0)
    c = transport.system(around_block).step(np.ones(transport.matrices.nodes))
    outer = fem.locate_dofs_topological(fem.functionspace(block.mesh, ("Lagrange", 1)), 1, block.facet_tags.find(OUTER))
    assert len(outer) == 80 and not c[outer].any()
    calm = Transport(block, TransportOptions(), 1.0)
    still = calm.system(calm.uniform_velocity(0.0, 0.0)).step(np.ones(calm.matrices.nodes))
    points = nodes_of(block)
    inside = (np.abs(points - 50.0) < 25.0).all(axis=1)  # with the building; too far in for the boundary to be felt
    np.testing.assert_allclose(still[inside], 1.0, atol=1e-5)


def test_no_gas_stays_no_gas(block, around_block):
    transport = Transport(block, TransportOptions(), 1.0)
    assert not transport.system(around_block).step(np.zeros(transport.matrices.nodes)).any()


def test_supg_undershoots_less_than_galerkin():
    empty = rectangle(20, 20, (200.0, 200.0))
    lowest = {}
    for scheme in ("galerkin", "supg"):
        transport = Transport(empty, TransportOptions(diffusion=0.01, scheme=scheme), 0.25)
        system = transport.system(transport.uniform_velocity(5.0, 0.3))
        c = bell(nodes_of(empty), [50.0, 70.0], 8.0)
        for _ in range(60):
            c = system.step(c)
        lowest[scheme] = c.min()
    assert lowest["galerkin"] < -0.02
    assert 0.7 * lowest["galerkin"] < lowest["supg"] <= 0.0


def test_what_the_iteration_cannot_do_is_solved_directly(block, around_block):
    c = bell(nodes_of(block), [27.0, 52.0], 4.0)
    patient, impatient = (Transport(block, TransportOptions(max_iterations=most), 100.0) for most in (500, 1))
    system = impatient.system(around_block)
    for _ in range(2):
        np.testing.assert_allclose(system.step(c), patient.system(around_block).step(c), atol=1e-11)
    assert system._solver.getConvergedReason() <= 0


@pytest.mark.parametrize("speed, strength", [(1.0, 0), (10.0, 1), (200.0, 2)])
def test_the_solver_suits_the_wind_from_the_start(block, speed, strength):
    transport = Transport(block, TransportOptions(), 1.0)
    c = bell(nodes_of(block), [27.0, 52.0], 4.0)
    system = transport.system(transport.uniform_velocity(speed, 0.3))
    after = system.step(c)
    indptr, indices, values = system._after.getValuesCSR()
    matrix, right = csr_matrix((values, indices, indptr)), system._before @ c
    right[transport.matrices.outer] = 0.0
    assert np.linalg.norm(matrix @ after - right) <= 1e-12 * np.linalg.norm(right)
    assert system.strength == strength and system.solved_directly is (strength == 2)


@pytest.mark.parametrize("bound, strength", [(2.5, 1), (12.0, 2)])
def test_a_wind_exceeds_a_bound_if_more_than_one_row_in_twenty_does(block, bound, strength):
    """The off-diagonal sum is just above or just below the bound, in just enough rows or in one row too few."""
    transport = Transport(block, TransportOptions(), 1.0)
    counts = np.diff(transport.matrices.sparsity.indptr) - 1
    rows = np.repeat(np.arange(transport.matrices.nodes), counts + 1)
    least = transport.matrices.nodes // 20 + 1
    for times, enough, expected in ((1.01, 0, strength), (0.99, 0, strength - 1), (1.01, 1, 0)):
        beyond = np.arange(transport.matrices.nodes) < least - enough
        values = (np.where(beyond, -times * bound, 0.0) / counts)[rows]
        values[transport.matrices.diagonal] = -1.0
        assert system_module.strength(transport.matrices, values) == expected


def test_a_system_goes_from_weak_to_strong_winds_and_back(block):
    transport = Transport(block, TransportOptions(), 1.0)
    c = bell(nodes_of(block), [27.0, 52.0], 4.0)
    system = None
    for speed in (1.0, 200.0, 1.0, 150.0, 10.0, 1.0, 200.0, 10.0):
        wind = transport.uniform_velocity(speed, 0.3)
        system = transport.system(wind, system)
        assert np.array_equal(system.step(c), transport.system(wind).step(c))


def test_no_gas_stays_no_gas_in_a_strong_wind(block):
    transport = Transport(block, TransportOptions(), 1.0)
    system = transport.system(transport.uniform_velocity(200.0, 0.3))
    assert not system.step(np.zeros(transport.matrices.nodes)).any()
    assert np.abs(system.step(np.full(transport.matrices.nodes, 1e-200))).max() < 1e-190


def test_what_cannot_be_solved_is_refused(block, around_block):
    c = bell(nodes_of(block), [27.0, 52.0], 4.0)
    c[5] = np.nan
    with pytest.raises(SolverError, match="transport: a direct solve left a residual of nan"):
        Transport(block, TransportOptions(), 1.0).system(around_block).step(c)


def test_arrays_of_another_mesh_are_refused(block, around_block):
    transport = Transport(block, TransportOptions(), 1.0)
    with pytest.raises(ContractError, match=r"expected \d+ nodal values, got shape \(3,\)"):
        transport.system(around_block).step(np.zeros(3))
