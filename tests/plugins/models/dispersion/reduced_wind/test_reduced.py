"""The reduced wind: exact projection, reliable error estimate, fall-back; the bits do not depend on earlier solves."""

from dataclasses import replace

import numpy as np
import pytest
from flow_meshes import rectangle

from dafw.core.errors import ConfigurationError, ContractError
from dafw.core.options import build
from dafw.core.rng import Streams
from dafw.plugins.models.dispersion.model_ins import AdvectionDiffusionINS
from dafw.plugins.models.dispersion.reduced_wind.advection import ReducedAdvection
from dafw.plugins.models.dispersion.reduced_wind.flow import SAFETY, solve_modes
from dafw.plugins.models.dispersion.reduced_wind.projection import FUNCTIONALS, enrich, project
from dafw.plugins.models.dispersion.reduced_wind.velocity_space import VelocitySpace
from dafw.plugins.models.dispersion.transport.options import TransportOptions
from dafw.plugins.models.dispersion.transport.transport import Transport
from dafw.plugins.models.dispersion.wind.options import BasisOptions, WindOptions
from dafw.plugins.models.dispersion.wind.solver import WindSolver
from dafw.plugins.models.dispersion.wind_solvers import wind_solver

BASIS = BasisOptions(directions=8, levels=3, max_intensity=5.0, modes=40)
VISCOSITY = 20.0


@pytest.fixture(scope="module")
def block():
    """100 m x 100 m with a building in the middle."""
    return rectangle(10, 10, (100.0, 100.0), [(40.0, 40.0, 60.0, 60.0)])


@pytest.fixture(scope="module")
def reference(block):
    return WindSolver(block, WindOptions(viscosity=VISCOSITY))


@pytest.fixture(scope="module")
def solver(block, cache):
    return wind_solver(block, WindOptions(viscosity=VISCOSITY, solver="reduced", basis=BASIS))


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """A cache folder for this module."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setenv("DAFW_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="module")
def space(reference):
    return VelocitySpace(reference.problem, reference.boundary)


def pinned(solver):
    """Return the solver's options with the basis that it uses."""
    return replace(solver.options, basis=replace(BASIS, digest=solver.digest))


def relative_error(space, found, wanted):
    error = found - wanted
    return np.sqrt(error @ space.mass @ error / (wanted @ space.mass @ wanted))


def test_modes_are_orthonormal_divergence_free_and_at_rest_on_the_boundary(solver, space, reference):
    velocities = solver.flow.basis.velocities
    modes = velocities[:, 2:]
    np.testing.assert_allclose(modes.T @ (space.dirichlet @ modes), np.eye(modes.shape[1]), atol=1e-12)
    np.testing.assert_allclose(velocities[:, :2].T @ (space.dirichlet @ modes), 0.0, atol=1e-7)
    problem = reference.problem
    for velocity in velocities.T:
        unknowns = np.zeros(problem.unknowns)
        unknowns[problem.velocity_dofs] = velocity
        np.testing.assert_allclose(problem.residual(unknowns, 0.0)[problem.pressure_dofs], 0.0, atol=1e-6)
    fixed, _ = reference.boundary.conditions(0.0)
    assert np.abs(modes[fixed[problem.velocity_dofs]]).max() < 1e-7


def test_reduced_equations_are_the_full_ones_tested_with_the_modes(solver, reference):
    basis, problem = solver.flow.basis, reference.problem
    modes = basis.velocities[:, 2:]
    rng = np.random.default_rng(0)
    for reynolds in (0.0, 0.3, 2.0):
        coefficients = rng.normal(size=basis.velocities.shape[1])
        coefficients[:2] = np.cos(1.0), np.sin(1.0)
        unknowns = np.zeros(problem.unknowns)
        unknowns[problem.velocity_dofs] = basis.velocities @ coefficients
        full = modes.T @ problem.residual(unknowns, reynolds)[problem.velocity_dofs]
        reduced = coefficients[2:] + reynolds * np.einsum("ijk,j,k->i", basis.quadratic, coefficients, coefficients)
        # the lifts are orthogonal to the modes only to the accuracy to which the snapshots are divergence-free
        np.testing.assert_allclose(reduced, full, atol=1e-7)
        convection = problem.residual(unknowns, 1.0) - problem.residual(unknowns, 0.0)
        exact = modes.T @ convection[problem.velocity_dofs]
        projected = np.einsum("ijk,j,k->i", basis.quadratic, coefficients, coefficients)
        np.testing.assert_allclose(projected, exact, rtol=1e-10, atol=1e-10 * np.abs(exact).max())


def test_an_enriched_basis_is_the_one_projected_anew(solver, space, reference):
    parameters = np.array([(reference.reynolds(intensity), 0.3) for intensity in (6.0, 7.0)])
    winds = [reference.problem.velocity(reference.solve(intensity, 0.3).unit) for intensity in (6.0, 7.0)]
    richer = enrich(space, solver.flow.basis, parameters, np.stack(winds, axis=1))
    anew = project(space, richer.velocities[:, 2:], richer.parameters, richer.coefficients.T)
    assert len(richer.quadratic) == len(solver.flow.basis.quadratic) + 2
    for name, array in anew.arrays().items():
        np.testing.assert_allclose(
            richer.arrays()[name], array, rtol=0.0, atol=1e-11 * np.abs(array).max(), err_msg=name
        )


def test_newton_solves_the_reduced_equations(solver):
    tensor = solver.flow.basis.quadratic
    coefficients = np.zeros(tensor.shape[1])
    coefficients[0] = 1.0
    assert solve_modes(tensor, 0.2, coefficients, small_step=1e-6) < 8
    left = coefficients[2:] + 0.2 * np.einsum("ijk,j,k->i", tensor, coefficients, coefficients)
    assert np.linalg.norm(left) < 1e-10 * np.linalg.norm(coefficients)


def test_winds_of_the_basis_come_back(solver, reference, space):
    for reynolds, direction in solver.flow.basis.parameters[::5]:
        found = solver.flow.solve(reynolds, direction)
        wanted = reference.problem.velocity(reference.solve(reynolds * VISCOSITY, direction).unit)
        assert relative_error(space, solver.flow.basis.velocities @ found.coefficients, wanted) < 2e-3


def test_all_modes_give_the_snapshots_back_exactly(block, reference, space, tmp_path, monkeypatch):
    monkeypatch.setenv("DAFW_CACHE", str(tmp_path))
    few = BasisOptions(directions=4, levels=1, max_intensity=2.0, modes=100)
    solver = wind_solver(block, WindOptions(viscosity=VISCOSITY, solver="reduced", basis=few))
    for reynolds, direction in solver.flow.basis.parameters:
        wanted = reference.problem.velocity(reference.solve(2.0, direction).unit)
        found = solver.flow.basis.velocities @ solver.flow.solve(reynolds, direction).coefficients
        assert relative_error(space, found, wanted) < 1e-6


@pytest.mark.parametrize("accepted", [0.0, 0.01, 0.05])
def test_the_estimate_bounds_the_error_of_winds_it_never_saw(solver, reference, space, accepted):
    rng = np.random.default_rng(3)
    ratios = []
    for intensity, direction in zip(rng.uniform(0.2, 5.0, 16), rng.uniform(0.0, 2 * np.pi, 16), strict=True):
        found = solver.flow.solve(intensity / VISCOSITY, direction, accepted)
        wanted = reference.problem.velocity(reference.solve(intensity, direction).unit)
        error = relative_error(space, solver.flow.basis.velocities @ found.coefficients, wanted)
        assert error <= found.error
        ratios.append(found.error / error)
    assert max(ratios) < 6.0  # but not much larger


def test_the_functionals_measure_the_stokes_flow_of_what_is_left(solver, space, reference):
    basis = solver.flow.basis
    rng = np.random.default_rng(5)
    ratios = []
    for reynolds in (0.1, 0.2):
        coefficients = solver.flow.solve(reynolds, 0.3).coefficients.copy()
        coefficients[2:] += 0.1 * rng.normal(size=coefficients.size - 2)
        velocity = basis.velocities @ coefficients
        unknowns = np.zeros(reference.problem.unknowns)
        unknowns[reference.problem.velocity_dofs] = velocity
        flow = space.riesz(reference.problem.residual(unknowns, reynolds)[reference.problem.velocity_dofs])
        exact = np.sqrt(flow @ space.mass @ flow / (velocity @ space.mass @ velocity))
        ratios.append(solver.flow.error(reynolds, coefficients) / (SAFETY * exact))
    assert np.abs(np.array(ratios) - 1.0).max() < 4 * np.sqrt(0.5 / FUNCTIONALS)  # four standard deviations


def test_what_the_basis_does_not_know_is_solved_in_full(block, solver, reference):
    strong = 12.0
    found = solver.solve(strong, 0.4)
    assert not solver.trusts(found.unit) and found.residual <= 1e-8
    wind, exact = solver.velocity(found), reference.velocity(reference.solve(strong, 0.4))
    np.testing.assert_allclose(wind.x.array, exact.x.array, atol=1e-5)
    fresh = wind_solver(block, pinned(solver))
    np.testing.assert_array_equal(fresh.velocity(found.unit, strong).x.array, wind.x.array)


def test_a_coarser_tolerance_takes_fewer_modes(solver):
    exact = solver.flow.solve(0.1, 0.4)
    coarse = solver.flow.solve(0.1, 0.4, accepted=2.0 * solver.flow.solve(0.1, 0.4, accepted=np.inf).error)
    assert np.count_nonzero(coarse.coefficients[2:]) == BASIS.modes // 2
    assert np.count_nonzero(exact.coefficients[2:]) == BASIS.modes
    assert exact.error < coarse.error


@pytest.mark.parametrize("kind", ["accelerated", "reduced"])
def test_results_do_not_depend_on_what_was_solved_before(block, solver, kind):
    options = replace(pinned(solver), solver=kind)
    used, fresh = wind_solver(block, options), wind_solver(block, options)
    winds = [(3.0, 0.4), (12.0, 2.0), (0.0, 1.0), (0.7, 0.4), (3.1, 0.45)]
    first = [used.solve(*wind) for wind in winds]
    again = [used.solve(*wind, start=first[0].unit) for wind in winds]
    other = [fresh.solve(*wind) for wind in reversed(winds)][::-1]
    used.solve_ahead(winds, 3)
    side_by_side = [used.solve(*wind) for wind in winds]
    for a, b, c, d in zip(first, again, other, side_by_side, strict=True):
        np.testing.assert_array_equal(a.unit, b.unit)
        np.testing.assert_array_equal(a.unit, c.unit)
        np.testing.assert_array_equal(a.unit, d.unit)
        np.testing.assert_array_equal(used.velocity(a).x.array, fresh.velocity(c).x.array)


def test_accelerated_winds_are_those_of_newton(block, solver, reference):
    accelerated = wind_solver(block, replace(pinned(solver), solver="accelerated"))
    for wind in ((0.0, 1.0), (0.3, 1.1), (2.2, 3.3), (4.7, 5.9), (9.0, 0.2)):
        found, wanted = accelerated.solve(*wind), reference.solve(*wind)
        assert found.residual <= 1e-8
        np.testing.assert_allclose(
            accelerated.velocity(found, 1.0).x.array, reference.velocity(wanted, 1.0).x.array, atol=1e-6
        )
    found = accelerated.solve(2.2, 3.3)
    assert found.iterations == 0  # it made no factorisation
    seen = reference.solve(2.2, 3.3, found.unit)  # Newton takes no step, and computes the same residual
    assert seen.iterations == 0
    np.testing.assert_allclose(seen.residual, found.residual, rtol=1e-12)


@pytest.mark.parametrize("scheme, outflow", [("galerkin", "zero"), ("galerkin", "open"), ("fct", "open")])
def test_advection_in_a_reduced_wind_is_a_sum_of_matrices(block, solver, scheme, outflow):
    transport = Transport(block, TransportOptions(scheme=scheme, outflow=outflow), 1.0)
    advection = ReducedAdvection(transport, solver, accepted=0.0)
    found = solver.solve(2.5, 4.0)
    assert advection.holds(found.unit)
    assembled = transport.advection(solver.velocity(found))
    summed = advection.matrix(found.unit, 2.5)
    np.testing.assert_allclose(summed, assembled, atol=1e-12 * np.abs(assembled).max())
    cloud = np.random.default_rng(0).uniform(size=transport.matrices.nodes)
    np.testing.assert_allclose(
        transport.system_of(summed).step(cloud), transport.system(solver.velocity(found)).step(cloud), atol=1e-10
    )


def test_single_precision_of_small_modes_is_not_seen_in_concentrations(block, solver):
    transport = Transport(block, TransportOptions(), 1.0)
    exact, quick = ReducedAdvection(transport, solver, accepted=0.0), ReducedAdvection(transport, solver)
    rows, cloud = transport.matrices.sparsity.rows, np.random.default_rng(0).uniform(size=transport.matrices.nodes)
    for wind in ((0.3, 1.1), (2.5, 4.0), (4.9, 5.9)):
        unit = solver.solve(*wind).unit
        wanted, found = exact.matrix(unit, wind[0]), quick.matrix(unit, wind[0])
        assert not np.array_equal(found, wanted)
        np.testing.assert_allclose(found, wanted, atol=1e-7 * np.abs(wanted).max())
        np.testing.assert_allclose(np.bincount(rows, found), 0.0, atol=1e-13 * np.abs(wanted).max())
        np.testing.assert_allclose(
            transport.system_of(found).step(cloud), transport.system_of(wanted).step(cloud), atol=1e-8
        )


def test_proportional_closure_needs_one_parameter(block, tmp_path, monkeypatch):
    monkeypatch.setenv("DAFW_CACHE", str(tmp_path))
    options = WindOptions(viscosity=VISCOSITY, closure="proportional", solver="reduced", basis=BASIS)
    solver = wind_solver(block, options)
    assert len(solver.flow.basis.parameters) == 8
    slow, fast = solver.solve(0.1, 1.0), solver.solve(20.0, 1.0)
    assert solver.trusts(slow.unit)
    np.testing.assert_array_equal(slow.unit, fast.unit)


def test_an_outflow_has_no_basis(block):
    with pytest.raises(ConfigurationError, match="'reduced' expects boundary 'uniform', got 'outflow'"):
        wind_solver(block, WindOptions(boundary="outflow", solver="reduced"))
    with pytest.raises(ConfigurationError, match="'accelerated' expects boundary 'uniform', got 'outflow'"):
        build(AdvectionDiffusionINS, {"wind": {"solver": "accelerated", "boundary": "outflow"}}, "model")


def test_arguments_that_make_no_sense_are_refused(solver):
    with pytest.raises(ContractError, match="intensity"):
        solver.solve(np.nan, 0.0)
    with pytest.raises(ContractError, match="start"):
        solver.solve(1.0, 0.0, np.zeros(3))


@pytest.mark.parametrize("name", ["accelerated", "reduced"])
def test_a_study_with_a_cheap_wind_is_that_with_newtons(small_model, tmp_path, monkeypatch, name):
    monkeypatch.setenv("DAFW_CACHE", str(tmp_path))
    basis = {"directions": 8, "levels": 2, "max_intensity": 6.0, "modes": 60}
    members, streams = {}, Streams(4)
    for kind in ("newton", name):
        model = build(AdvectionDiffusionINS, small_model | {"wind": {"solver": kind, "basis": basis}}, "model 'test'")
        belief = model.first_guess(3, streams.members("initial", 0))
        for cycle in range(3):
            belief = model.forecast(belief.ensemble, belief.memory, streams.members("error", cycle))
        members[kind] = belief.ensemble.members
    bound = 1e-6 if name == "accelerated" else 0.01  # to the tolerance of the wind; the largest concentration is 1
    assert np.abs(members[name] - members["newton"]).max() < bound
    assert not np.array_equal(members[name], members["newton"])


def test_members_stepped_apart_give_the_same_bits(small_model, tmp_path, monkeypatch):
    monkeypatch.setenv("DAFW_CACHE", str(tmp_path))
    basis = {"directions": 4, "levels": 1, "max_intensity": 3.0, "modes": 20, "tolerance": 0.02}
    options = small_model | {"wind": {"solver": "reduced", "basis": basis}}
    streams, model = Streams(4), build(AdvectionDiffusionINS, options, "model 'test'")
    whole = model.first_guess(4, streams.members("initial", 0))
    together = model.forecast(whole.ensemble, whole.memory, streams.members("error", 0))
    assert model.pinned_options() == {"wind": {"basis": {"digest": model.solver.digest}}}
    pinned = {"solver": "reduced", "basis": basis | model.pinned_options()["wind"]["basis"]}
    for first, last in ((2, 4), (0, 2)):
        other = build(AdvectionDiffusionINS, small_model | {"wind": pinned}, "model 'test'")
        memory = {name: array[first:last] for name, array in whole.memory.items()}
        rng = streams.members("error", 0).shifted(first)
        part = other.step_with_memory(whole.ensemble.members[first:last], memory, 0.0, rng)
        np.testing.assert_array_equal(part.members, together.ensemble.members[first:last])
    trusted = together.memory["unit"][:, -1]
    assert 0 < trusted.sum() < 4  # some of both kinds
