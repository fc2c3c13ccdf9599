"""Flux-corrected transport: no undershoots, no overshoots, an exact account of the gas, second order."""

import dolfinx_solver  # noqa: F401  (before dolfinx)

# isort: split
import numpy as np
import pytest
import ufl
from dolfinx import fem
from flow_meshes import rectangle
from numba import typeof

from dafw.commands import first_imports
from dafw.core.errors import ConfigurationError, ContractError, SolverError
from dafw.plugins.models.dispersion.fem import paired_lu
from dafw.plugins.models.dispersion.transport import flux_corrected
from dafw.plugins.models.dispersion.transport.limiter import corrected as limited_step
from dafw.plugins.models.dispersion.transport.limiter import fluxes
from dafw.plugins.models.dispersion.transport.options import TransportOptions, require_one_process
from dafw.plugins.models.dispersion.transport.transport import Transport
from dafw.plugins.models.dispersion.wind.options import WindOptions
from dafw.plugins.models.dispersion.wind.solver import WindSolver

RIMS = pytest.mark.parametrize("outflow", ["zero", "open"])
SOLVERS = pytest.mark.parametrize("solver", ["iterative", "direct"])


@pytest.fixture(scope="module")
def block():
    """100 m x 100 m with a building."""
    return rectangle(20, 20, (100.0, 100.0), [(30.0, 40.0, 50.0, 60.0)])


@pytest.fixture(scope="module")
def around_block(block):
    """A wind of 8 m/s around it, solved badly: it is far from free of divergence."""
    solver = WindSolver(block, WindOptions(viscosity=10.0, tolerance=1e-2))
    return solver.velocity(solver.solve(8.0, 0.3))


def corrected(tagged, dt=1.0, **options):
    return Transport(tagged, TransportOptions(scheme="fct", **options), dt)


def bell(points, centre, radius):
    return np.exp(-((points - centre) ** 2).sum(axis=1) / (2 * radius**2))


def error(transport, nodal, exact):
    """L2 error of a nodal concentration."""
    function = fem.Function(transport.matrices.space)
    function.x.array[:] = nodal
    return np.sqrt(fem.assemble_scalar(fem.form((function - exact) ** 2 * ufl.dx(metadata={"quadrature_degree": 6}))))


@RIMS
@SOLVERS
def test_a_run_stays_between_zero_and_its_maximum_and_keeps_account_of_the_gas(block, around_block, outflow, solver):
    transport = corrected(block, outflow=outflow, diffusion=0.1, solver=solver)
    system = transport.system(around_block)
    galerkin = Transport(block, TransportOptions(outflow=outflow, diffusion=0.1), 1.0).system(around_block)
    cloud = start = bell(transport.matrices.places, [20.0, 52.0], 4.0)
    uncorrected, account, lowest, undershoot = start, 0.0, 0.0, 0.0
    for _ in range(20):
        cloud, gone = system.balanced_step(cloud)
        uncorrected = galerkin.step(uncorrected)
        account += gone
        lowest, undershoot = min(lowest, cloud.min()), min(undershoot, uncorrected.min())
        assert cloud.max() <= start.max()
        assert system.gas(cloud) + account == pytest.approx(system.gas(start), rel=1e-12)
    assert lowest >= 0.0 and undershoot < -0.1
    assert 0.1 * system.gas(start) < account < 0.99 * system.gas(start)  # much has left, and not all


@RIMS
@pytest.mark.parametrize("speed, dt", [(3.0, 1.0), (200.0, 1.0), (5.0, 1000.0)])
def test_no_time_step_and_no_wind_makes_less_than_nothing(block, outflow, speed, dt):
    transport = corrected(block, dt, outflow=outflow)
    system = transport.system(transport.uniform_velocity(speed, 0.3))
    spikes = np.where(np.random.default_rng(0).random(transport.matrices.nodes) < 0.1, 1.0, 0.0)
    source = 0.5 * spikes[::-1] / dt
    after, gone = system.balanced_step(spikes, source)
    assert after.min() >= 0.0 and after.max() <= 1.5 and after.max() > 0.0
    assert system.gas(after) + gone == pytest.approx(system.gas(spikes + dt * source), rel=1e-12)


def test_a_closed_site_keeps_its_gas(block):
    """Without wind nothing crosses an open boundary, and an even concentration stays as it is."""
    transport = corrected(block, outflow="open")
    system = transport.system(transport.uniform_velocity(0.0, 0.0))
    even = np.full(transport.matrices.nodes, 0.7)
    after, gone = system.balanced_step(even)
    np.testing.assert_allclose(after, even, rtol=1e-12)
    assert gone == 0.0


@RIMS
def test_gas_is_the_integral_of_the_concentration(block, outflow):
    transport = corrected(block, outflow=outflow)
    system = transport.system(transport.uniform_velocity(1.0, 0.0))
    cloud = fem.Function(transport.matrices.space)
    cloud.x.array[:] = bell(transport.matrices.places, [70.0, 52.0], 8.0)
    assert system.gas(cloud.x.array) == pytest.approx(fem.assemble_scalar(fem.form(cloud * ufl.dx)), rel=1e-12)


def manufactured_error(cells, dt, diffusion):
    """Error of c = (1 + t) sin(pi x) sin(pi y) in a vortex on the unit square at t = 1."""
    transport = corrected(rectangle(cells, cells), dt, diffusion=diffusion)
    wind = fem.Function(fem.functionspace(transport.matrices.space.mesh, ("Lagrange", 2, (2,))))
    wind.interpolate(lambda p: np.array([1 + p[0] ** 2, -2 * p[0] * p[1]]))
    x, y = transport.matrices.places.T
    shape = np.sin(np.pi * x) * np.sin(np.pi * y)
    advected = np.pi * (
        (1 + x**2) * np.cos(np.pi * x) * np.sin(np.pi * y) - 2 * x * y * np.sin(np.pi * x) * np.cos(np.pi * y)
    )
    system, c = transport.system(wind), shape
    for step in range(1, round(1.0 / dt) + 1):
        c = system.step(c, shape + (1 + step * dt) * (advected + 2 * np.pi**2 * diffusion * shape))
    p = ufl.SpatialCoordinate(transport.matrices.space.mesh)
    return error(transport, c, 2.0 * ufl.sin(np.pi * p[0]) * ufl.sin(np.pi * p[1]))


@pytest.mark.parametrize("diffusion", [0.05, 1e-4])
def test_manufactured_solution_converges_with_order_two(diffusion):
    # backward Euler is exact for what grows linearly in time; time step and mesh size are halved together
    coarse, middle, fine = (manufactured_error(cells, 0.4 / cells, diffusion) for cells in (8, 16, 32))
    assert np.log2(coarse / middle) >= 1.8 and np.log2(middle / fine) >= 1.8


def travelled_error(cells, dt):
    """Error of a Gaussian cloud that a uniform wind has carried over a fifth of the unit square."""
    transport = corrected(rectangle(cells, cells), dt, diffusion=1e-3, outflow="open")
    system = transport.system(transport.uniform_velocity(0.4, 0.5))
    c = bell(transport.matrices.places, [0.4, 0.4], 0.1)
    for _ in range(round(0.5 / dt)):
        c = system.step(c)
    x, spread = ufl.SpatialCoordinate(transport.matrices.space.mesh), 0.1**2 + 2 * 1e-3 * 0.5
    off = (x[0] - 0.4 - 0.2 * np.cos(0.5)) ** 2 + (x[1] - 0.4 - 0.2 * np.sin(0.5)) ** 2
    return error(transport, c, 0.1**2 / spread * ufl.exp(-off / (2.0 * spread)))


def test_a_travelling_cloud_converges_with_more_than_order_one_and_a_half():
    # the time step is quartered where the mesh size is halved, because backward Euler is of order one
    coarse, fine = (travelled_error(cells, 0.1 * (16 / cells) ** 2) for cells in (16, 32))
    assert np.log2(coarse / fine) >= 1.5


def into(edges, flux):
    """What fluxes along the edges, into the first node and out of the second, bring into every node."""
    n = edges.starts.size - 1
    first = np.repeat(np.arange(n), np.diff(edges.starts.astype(int)))
    return np.bincount(first, flux, n) - np.bincount(edges.second, flux, n)


def parts_of_a_step(transport, wind, cloud):
    """The solutions of high and of low order, and what else the limiter is given, without the source."""
    system = transport.system(wind)
    return *system._predictors.solve(cloud, cloud, None), system._entries, system._nodal


@RIMS
def test_unlimited_fluxes_lead_to_the_step_of_galerkin(block, outflow):
    solver = WindSolver(block, WindOptions(viscosity=10.0, tolerance=1e-12))
    transport = corrected(block, outflow=outflow)
    edges, cloud = transport.matrices.edges, bell(transport.matrices.places, [80.0, 52.0], 8.0)
    wind = solver.velocity(solver.solve(8.0, 0.3))
    high, low, entries, (mass, leaving, _) = parts_of_a_step(transport, wind, cloud)
    assert np.abs(high - low).max() > 0.05
    flux = fluxes(edges.starts, edges.second, entries, leaving, high, low, cloud)[0]
    received = into(edges, flux) + leaving * (low - high)
    received[transport.matrices.fixed] = 0.0
    np.testing.assert_allclose(low + received / mass, high, atol=1e-9)


@RIMS
def test_a_step_is_what_dense_matrices_of_fluxes_give(block, around_block, outflow):
    """An independent evaluation of Zalesak's limiter, from the equations in the files."""
    transport = corrected(block, outflow=outflow, diffusion=0.1)
    matrices, cloud = transport.matrices, bell(transport.matrices.places, [20.0, 52.0], 4.0)
    high, low, _, (mass, leaving, _) = parts_of_a_step(transport, around_block, cloud)
    before, operator = (
        matrices.sparsity.csr(values).toarray()
        for values in (matrices.before.data, transport._without_inflow(transport.advection(around_block)))
    )
    operator += matrices.sparsity.csr(matrices.calm - matrices.before.data).toarray()
    diffusion = np.maximum(0.0, np.maximum(operator, operator.T))
    change, excess = high - cloud, high - low
    np.fill_diagonal(diffusion, 0.0)
    there = operator - diffusion
    flux = before * np.subtract.outer(change, change) + diffusion * np.subtract.outer(high, high)
    flux = matrices.dt * (flux - there * excess + there.T * excess[:, None])
    np.fill_diagonal(flux, 0.0)
    outside, near = leaving * (low - high), before != 0.0
    lowest = np.where(near, np.minimum(low, cloud), np.inf).min(axis=1)
    highest = np.where(near, np.maximum(low, cloud), -np.inf).max(axis=1)
    rise = np.maximum(flux, 0.0).sum(axis=1) + np.maximum(outside, 0.0)
    fall = np.minimum(flux, 0.0).sum(axis=1) + np.minimum(outside, 0.0)
    up, down = mass * (highest - low), mass * (lowest - low)
    may_rise, may_fall = np.ones((2, cloud.size))
    np.divide(up, rise, out=may_rise, where=rise > up)
    np.divide(down, fall, out=may_fall, where=fall < down)
    may_rise[matrices.fixed] = may_fall[matrices.fixed] = 1.0
    shares = np.where(flux > 0.0, np.minimum.outer(may_rise, may_fall), np.minimum.outer(may_fall, may_rise))
    received = (shares * flux).sum(axis=1) + outside * np.where(outside > 0.0, may_rise, may_fall)
    received[matrices.fixed] = 0.0
    assert 0.01 < (shares[flux > 1e-3] < 1.0).mean() < 0.99
    step = transport.system(around_block).step(cloud)
    np.testing.assert_allclose(step, low + received / mass, rtol=0.0, atol=1e-13)


def test_the_limiter_keeps_to_the_range_and_leaves_small_fluxes_alone(block):
    """Whatever the solutions and the matrix are: here they are random numbers."""
    matrices = corrected(block).matrices
    edges, n, generator = matrices.edges, matrices.nodes, np.random.default_rng(0)
    entries, free = generator.standard_normal((3, edges.second.size)), np.ones(n, dtype=bool)
    nodal = np.stack([1.0 + generator.random(n), generator.random(n), np.zeros(n)])
    mass, leaving, _ = nodal
    high, low, supplied = generator.standard_normal((3, n))

    def step(high, low, supplied, free=free, entries=entries):
        return limited_step(edges.starts, edges.second, entries, nodal, free, high, low, supplied)

    after, gone = step(high, low, supplied)
    near = matrices.sparsity.csr(np.ones(matrices.sparsity.indices.size)).toarray() > 0.0
    assert (after >= np.where(near, np.minimum(low, supplied), np.inf).min(axis=1)).all()
    assert (after <= np.where(near, np.maximum(low, supplied), -np.inf).max(axis=1)).all()
    # The limited fluxes alone keep to the range: the account would not be right if values were cut off afterwards.
    assert mass @ after + gone == pytest.approx(mass @ low + leaving @ low, rel=1e-12)
    assert np.abs(after - low).max() > 0.1
    wide, gentle = np.where(generator.random(n) < 0.5, -1e6, 1e6), entries * np.array([[0.0], [1.0], [1.0]])
    flux = fluxes(edges.starts, edges.second, gentle, leaving, high, low, wide)[0]
    received = into(edges, flux) + leaving * (low - high)
    surrounded = (near @ (wide > 0.0)) & (near @ (wide < 0.0))  # their range is wide enough for all fluxes
    among = near @ ~surrounded == 0
    assert among.sum() > 100
    np.testing.assert_allclose(
        step(high, low, wide, entries=gentle)[0][among], (low + received / mass)[among], rtol=1e-12
    )
    even = np.full(n, 0.7)
    after, _ = step(high, even, even)
    np.testing.assert_array_equal(after, even)
    after, _ = step(high, low, supplied, np.zeros(n, dtype=bool))
    np.testing.assert_array_equal(after, low)


def test_edges_are_the_pairs_of_neighbours(block):
    matrices = corrected(block).matrices
    edges, indices, rows = matrices.edges, matrices.sparsity.indices, matrices.sparsity.rows
    first = np.repeat(np.arange(matrices.nodes), np.diff(edges.starts.astype(int)))
    assert 2 * first.size == indices.size - matrices.nodes
    np.testing.assert_array_equal([rows[edges.there], indices[edges.there]], [first, edges.second])
    np.testing.assert_array_equal([rows[edges.back], indices[edges.back]], [edges.second, first])


def test_the_diffusion_can_be_that_of_a_member(block, around_block):
    cloud = bell(corrected(block).matrices.places, [70.0, 52.0], 8.0)
    given = corrected(block).system(around_block, diffusion=2.5).step(cloud)
    np.testing.assert_allclose(given, corrected(block, diffusion=2.5).system(around_block).step(cloud), atol=1e-10)
    assert np.abs(given - corrected(block).system(around_block).step(cloud)).max() > 1e-3


@pytest.mark.parametrize("scheme", ["galerkin", "supg", "fct"])
def test_an_open_boundary_lets_a_cloud_out_as_if_the_site_went_on(scheme):
    """On a site twice as long the cloud is the same; with zero concentration on the boundary it is not."""
    places, clouds = {}, {}
    for columns, outflow in ((40, "open"), (20, "open"), (20, "zero")):
        site = rectangle(columns, 20, (5.0 * columns, 100.0))
        transport = Transport(site, TransportOptions(scheme=scheme, outflow=outflow, diffusion=2.0), 1.0)
        system = transport.system(transport.uniform_velocity(4.0, 0.0))
        c = bell(transport.matrices.places, [75.0, 50.0], 12.0)
        for _ in range(6):
            c = system.step(c)
        order = np.lexsort(transport.matrices.places.T.round(6))
        order = order[transport.matrices.places[order, 0] <= 100.0 + 1e-9]
        places[columns, outflow], clouds[columns, outflow] = transport.matrices.places[order], c[order]
    np.testing.assert_allclose(places[20, "open"], places[40, "open"], atol=1e-9)
    far = clouds[40, "open"]
    assert far.max() > 0.4 and far[places[40, "open"][:, 0] > 99.0].max() > 0.3  # it is on its way out
    off = {outflow: np.abs(clouds[20, outflow] - far).max() for outflow in ("open", "zero")}
    assert off["open"] < 0.03 and off["zero"] > 0.3


@pytest.mark.parametrize("scheme", ["galerkin", "supg", "fct"])
def test_the_wind_brings_clean_air_through_an_open_boundary(block, scheme):
    transport = Transport(block, TransportOptions(scheme=scheme, outflow="open"), 1.0)
    solver = WindSolver(block, WindOptions(viscosity=10.0))
    system = transport.system(solver.velocity(solver.solve(5.0, 0.0)))
    c = np.ones(transport.matrices.nodes)
    for _ in range(60):
        c = system.step(c)
    assert np.abs(c[transport.matrices.places[:, 0] < 25.0]).max() < 0.02


@RIMS
@SOLVERS
def test_a_system_made_over_has_the_bits_of_a_new_one(block, around_block, outflow, solver):
    transport = corrected(block, outflow=outflow, solver=solver)
    cloud = bell(transport.matrices.places, [70.0, 52.0], 8.0)
    system = transport.system(transport.uniform_velocity(9.0, 1.0))
    system.step(cloud[::-1].copy())
    assert transport.system(around_block, system) is system
    first = system.step(cloud)
    system.step(first)
    assert np.array_equal(system.step(cloud), first)
    assert np.array_equal(corrected(block, outflow=outflow, solver=solver).system(around_block).step(cloud), first)


@RIMS
def test_both_solvers_give_the_same_steps(block, around_block, outflow):
    first, second = (corrected(block, outflow=outflow, solver=solver) for solver in ("iterative", "direct"))
    cloud = bell(first.matrices.places, [70.0, 52.0], 8.0)
    rate = 0.1 * cloud[::-1]
    (one, gone), (other, also_gone) = (
        transport.system(around_block).balanced_step(cloud, rate) for transport in (first, second)
    )
    np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-11)
    assert also_gone == pytest.approx(gone, rel=1e-9)
    assert np.abs(one - cloud).max() > 0.1


def test_the_matrix_of_low_order_is_what_the_equations_say(block, around_block):
    """Of dense matrices; without fixed nodes, since their rows and columns are left out."""
    transport = corrected(block, outflow="open", solver="direct")
    matrices = transport.matrices
    added = transport._without_inflow(transport.advection(around_block))
    a = matrices.sparsity.csr(added + matrices.calm - matrices.before.data).toarray()
    expected = a - np.maximum(0.0, np.maximum(a, a.T))
    np.fill_diagonal(expected, 0.0)
    leaving = np.zeros(matrices.nodes)
    leaving[matrices.outer] = np.maximum(matrices.outward(added), 0.0)
    mass = np.asarray(matrices.before.sum(axis=1)).ravel()
    np.fill_diagonal(expected, mass + leaving - expected.sum(axis=0))
    cloud = bell(matrices.places, [20.0, 52.0], 4.0)
    predictors = transport.system(around_block)._predictors
    given = predictors.lumped * cloud
    _, low = predictors.factors.solve(given, given)
    np.testing.assert_allclose(expected @ low, mass * cloud, atol=1e-12)


def test_what_makes_no_sense_is_refused(block, around_block):
    transport = corrected(block)
    system = transport.system(around_block)
    with pytest.raises(ContractError, match=r"expected \d+ nodal values, got shape \(3,\)"):
        system.step(np.zeros(3))
    with pytest.raises(SolverError, match="residual of nan"):
        system.step(np.full(transport.matrices.nodes, np.nan))
    direct = corrected(block, solver="direct")
    with pytest.raises(SolverError, match="transport: a solution is not finite"):
        direct.system(around_block).step(np.full(transport.matrices.nodes, np.nan))
    with pytest.raises(SolverError, match=r"transport: sparse LU: .*; use transport.solver=iterative"):
        direct.system_of(np.full(transport.matrices.sparsity.indices.size, np.nan))
    for options, words in (
        ({"scheme": "fct"}, r"scheme 'fct' works in one process, expected 'galerkin' or 'supg'"),
        ({"outflow": "open"}, r"outflow 'open' works in one process, expected 'zero'"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            require_one_process(TransportOptions(**options))
    require_one_process(TransportOptions(scheme="supg"))


def test_set_up_compiles_the_loops_of_a_step(block, around_block, monkeypatch):
    """For arguments of other types, numba would compile them again in the first run."""
    compiled, called = {}, {}

    def noting(function):
        def call(*arguments):
            called[function.__name__] = tuple(map(typeof, arguments))
            return function(*arguments)

        return call

    for function, arguments in first_imports.loops():
        compiled[function.__name__] = arguments
        for module in (flux_corrected, paired_lu):
            if vars(module).get(function.__name__) is function:
                monkeypatch.setattr(module, function.__name__, noting(function))
    transport = corrected(block, outflow="open", solver="direct")
    start = bell(transport.matrices.places, [20.0, 52.0], 4.0)
    transport.system(around_block).balanced_step(start, start)
    assert called == compiled
