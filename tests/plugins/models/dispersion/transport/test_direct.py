"""The direct solver of the transport: the results of the iterative one, whatever was solved before."""

import dolfinx_solver  # noqa: F401  (before dolfinx)

# isort: split
import numpy as np
import pytest
from flow_meshes import rectangle

from dafw.core.errors import ConfigurationError, ContractError, SolverError
from dafw.plugins.models.dispersion.transport.options import TransportOptions, require_one_process
from dafw.plugins.models.dispersion.transport.transport import Transport
from dafw.plugins.models.dispersion.wind.options import WindOptions
from dafw.plugins.models.dispersion.wind.solver import WindSolver

WAYS = pytest.mark.parametrize(
    ("scheme", "outflow"),
    [("galerkin", "zero"), ("galerkin", "open"), ("supg", "zero"), ("fct", "zero"), ("fct", "open")],
)


@pytest.fixture(scope="module")
def block():
    """100 m x 100 m with a building."""
    return rectangle(20, 20, (100.0, 100.0), [(30.0, 40.0, 50.0, 60.0)])


@pytest.fixture(scope="module")
def around_block(block):
    solver = WindSolver(block, WindOptions(viscosity=10.0, tolerance=1e-12))
    return solver.velocity(solver.solve(2.0, 0.0))


def make(block, solver="direct", **options):
    return Transport(block, TransportOptions(solver=solver, **options), 1.0)


def cloud(transport):
    return np.exp(-((transport.matrices.places - [20.0, 50.0]) ** 2).sum(axis=1) / 128.0)


@WAYS
@pytest.mark.parametrize("leaks", [False, True])
def test_a_run_is_that_of_the_iterative_solver(block, around_block, scheme, outflow, leaks):
    runs = []
    for solver in ("iterative", "direct"):
        transport = make(block, solver, scheme=scheme, outflow=outflow)
        system, c = transport.system(around_block), cloud(transport)
        source = 0.1 * c if leaks else None
        runs.append([c := system.step(c, source) for _ in range(50)])
    assert np.abs(np.subtract(*runs)).max() <= 1e-9 * np.abs(runs[0]).max()


@pytest.mark.parametrize("speed", [0.0, 0.1, 10.0, 60.0, 200.0])
def test_steps_in_weak_and_strong_winds_solve_their_equations(block, speed):
    iterative, direct = (make(block, solver) for solver in ("iterative", "direct"))
    wind, c = direct.uniform_velocity(speed, 0.3), cloud(direct)
    np.testing.assert_allclose(direct.system(wind).step(c), iterative.system(wind).step(c), atol=1e-11)


@WAYS
def test_a_system_made_over_has_the_bits_of_a_new_one(block, around_block, scheme, outflow):
    transport = make(block, scheme=scheme, outflow=outflow)
    c = cloud(transport)
    system = transport.system(transport.uniform_velocity(9.0, 1.0))
    other = transport.system(transport.uniform_velocity(3.0, 2.0))
    system.step(c)
    assert transport.system(around_block, system) is system
    first = system.step(c)
    other.step(first)
    assert np.array_equal(system.step(c), first)
    assert np.array_equal(make(block, scheme=scheme, outflow=outflow).system(around_block).step(c), first)


def test_a_matrix_that_cannot_be_factorised_is_refused(block, monkeypatch):
    transport = make(block)
    lost = np.zeros(transport.matrices.sparsity.indices.size)
    with pytest.raises(SolverError, match=r"transport: sparse LU: .*singular.*use transport.solver=iterative"):
        transport.system_of(lost - transport.matrices.calm)


def test_what_is_not_a_concentration_is_refused(block, around_block):
    system = make(block).system(around_block)
    with pytest.raises(ContractError, match=r"expected \d+ nodal values, got shape \(3,\)"):
        system.step(np.zeros(3))
    with pytest.raises(SolverError, match="not finite"):
        system.step(np.full(block.mesh.geometry.x.shape[0], np.nan))


def test_a_divided_mesh_needs_the_iterative_solver():
    with pytest.raises(ConfigurationError, match="solver 'direct' works in one process, expected 'iterative'"):
        require_one_process(TransportOptions(solver="direct"))
