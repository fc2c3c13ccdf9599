"""The steady wind: symmetries, exact flows, limits, and an error if it has not converged."""

import dolfinx_solver  # noqa: F401  (before dolfinx)

# isort: split
import numpy as np
import pytest
import ufl
from dolfinx import fem
from flow_meshes import rectangle
from scipy.spatial import KDTree

from dafw.core.errors import ConfigurationError, ContractError
from dafw.plugins.models.dispersion.wind.options import WindOptions
from dafw.plugins.models.dispersion.wind.solution import WindError
from dafw.plugins.models.dispersion.wind.solver import WindSolver

BLOCK = [(40.0, 40.0, 60.0, 60.0)]


@pytest.fixture(scope="module")
def block():
    """100 m x 100 m with a building in the middle."""
    return rectangle(20, 20, (100.0, 100.0), BLOCK)


@pytest.fixture(scope="module")
def solver(block):
    return WindSolver(block, WindOptions(viscosity=10.0, tolerance=1e-11))


@pytest.mark.parametrize("boundary", ["uniform", "outflow"])
@pytest.mark.parametrize("direction", [0.0, 0.7, np.pi / 2, np.pi, 4.0])
def test_wind_over_an_empty_site_is_uniform(boundary, direction):
    empty = WindSolver(rectangle(5, 4, (500.0, 400.0)), WindOptions(boundary=boundary, tolerance=1e-12))
    wind = empty.velocity(empty.solve(5.0, direction)).x.array.reshape(-1, 2)
    expected = np.tile([5 * np.cos(direction), 5 * np.sin(direction)], (len(wind), 1))
    np.testing.assert_allclose(wind, expected, atol=1e-8)


@pytest.mark.parametrize("boundary", ["uniform", "outflow"])
def test_wind_turns_with_its_direction(block, boundary):
    solver = WindSolver(block, WindOptions(viscosity=10.0, boundary=boundary, tolerance=1e-11))
    east, north = (solver.velocity(solver.solve(3.0, d)) for d in (0.3, 0.3 + np.pi / 2))
    points = east.function_space.tabulate_dof_coordinates()[:, :2]
    turned = np.column_stack([100.0 - points[:, 1], points[:, 0]])
    distance, partner = KDTree(points).query(turned)
    assert distance.max() < 1e-9
    u, v = east.x.array.reshape(-1, 2).T
    np.testing.assert_allclose(north.x.array.reshape(-1, 2)[partner], np.column_stack([-v, u]), atol=1e-7)


def test_walls_stop_the_wind_and_the_rim_prescribes_it(block, solver):
    wind = solver.velocity(solver.solve(4.0, 1.0))
    space = wind.function_space
    values = wind.x.array.reshape(-1, 2)
    for tag, expected in ((1, [4 * np.cos(1.0), 4 * np.sin(1.0)]), (2, [0.0, 0.0])):
        nodes = fem.locate_dofs_topological(space, 1, block.facet_tags.find(tag))
        assert len(nodes) > 30
        np.testing.assert_allclose(values[nodes], np.tile(expected, (len(nodes), 1)), atol=1e-14)


def test_air_that_enters_leaves_through_a_do_nothing_outlet(block):
    solver = WindSolver(block, WindOptions(viscosity=10.0, boundary="outflow", tolerance=1e-11))
    wind = solver.velocity(solver.solve(3.0, 0.0))
    normal = ufl.FacetNormal(block.mesh)
    ds = ufl.Measure("ds", domain=block.mesh, subdomain_data=block.facet_tags)
    flux = fem.assemble_scalar(fem.form(ufl.inner(wind, normal) * ds(1)))
    entering = 3.0 * 100.0
    assert abs(flux) < 1e-8 * entering
    values, points = wind.x.array.reshape(-1, 2), wind.function_space.tabulate_dof_coordinates()
    outlet = values[points[:, 0] > 100.0 - 1e-9, 0]
    assert outlet.max() - outlet.min() > 0.1  # the wake crosses it freely


def test_proportional_closure_scales_the_wind_of_a_direction(block):
    solver = WindSolver(block, WindOptions(viscosity=10.0, closure="proportional", reference_intensity=5.0))
    slow, fast, calm = (solver.solve(intensity, 2.0) for intensity in (0.03, 17.0, 0.0))
    assert np.array_equal(slow.unit, fast.unit) and np.array_equal(slow.unit, calm.unit)
    np.testing.assert_allclose(
        solver.velocity(fast).x.array, 17.0 / 0.03 * solver.velocity(slow).x.array, rtol=1e-12, atol=1e-12
    )
    constant = WindSolver(block, WindOptions(viscosity=10.0)).solve(5.0, 2.0)
    assert np.array_equal(constant.unit, slow.unit)  # at the reference intensity the closures agree


def test_weak_winds_tend_to_stokes_flow_linearly(solver):
    stokes = solver.solve(0.0, 0.5).unit
    weak, weaker = (np.abs(solver.solve(i, 0.5).unit - stokes).max() for i in (2e-3, 1e-3))
    assert 0 < weak < 0.1 * np.abs(stokes).max()
    assert weak / weaker == pytest.approx(2.0, rel=0.02)


def test_calm_is_no_wind(solver):
    calm = solver.solve(0.0, 0.5)
    assert np.isfinite(calm.unit).all()
    assert not solver.velocity(calm).x.array.any()


def test_start_changes_the_way_and_not_the_wind(solver):
    cold = solver.solve(5.0, 1.0)
    for other in (solver.solve(5.5, 1.0), solver.solve(1.0, 1.0 + np.pi)):
        warm = solver.solve(5.0, 1.0, other.unit)
        np.testing.assert_allclose(warm.unit, cold.unit, atol=1e-7)
    again = solver.solve(5.0, 1.0, cold.unit)
    assert again.iterations == 0 and np.array_equal(again.unit, cold.unit)


def test_result_depends_on_the_arguments_alone(block):
    options = WindOptions(viscosity=10.0, tolerance=1e-11, max_steps=2)
    solver = WindSolver(block, options)
    start = solver.solve(2.0, 3.0).unit
    first = [solver.solve(6.0, 0.2).unit, solver.solve(6.0, 0.2, start).unit]
    solver.solve(9.0, 4.0)
    with pytest.raises(WindError):
        solver.solve(1e6, 4.0)
    assert np.array_equal(first[0], solver.solve(6.0, 0.2).unit)
    assert np.array_equal(first[1], solver.solve(6.0, 0.2, start).unit)
    fresh = WindSolver(block, options)
    assert np.array_equal(first[1], fresh.solve(6.0, 0.2, start).unit)


def test_continuation_finds_what_newton_alone_does_not(block):
    few = {"viscosity": 2.0, "max_iterations": 3}
    with pytest.raises(WindError):
        WindSolver(block, WindOptions(**few, max_steps=1)).solve(10.0, 0.2)
    found = WindSolver(block, WindOptions(**few)).solve(10.0, 0.2)
    patient = WindSolver(block, WindOptions(viscosity=2.0)).solve(10.0, 0.2)
    np.testing.assert_allclose(found.unit, patient.unit, atol=1e-5)


@pytest.mark.parametrize(
    ("options", "intensity"),
    [
        ({"viscosity": 1e-4, "max_iterations": 1, "max_steps": 1}, 5.0),
        ({"viscosity": 1e-4, "max_iterations": 3, "max_steps": 3}, 17.0),
        ({"viscosity": 10.0, "tolerance": 1e-30}, 5.0),
        ({"viscosity": 10.0, "max_steps": 2}, 1e150),
        ({"viscosity": 10.0}, 1e300),
    ],
)
@pytest.mark.parametrize("warm", [False, True])
def test_unconverged_wind_is_never_handed_out(block, options, intensity, warm):
    solver = WindSolver(block, WindOptions(**options))
    start = WindSolver(block, WindOptions(viscosity=10.0)).solve(1.0, 1.0).unit if warm else None
    with pytest.raises(WindError) as caught:
        solver.solve(intensity, 1.25, start)
    for part in (f"intensity {intensity:g} m/s", "direction 1.25 rad", "viscosity", "residual"):
        assert part in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.nan, 0.0), "intensity"),
        ((-1.0, 0.0), "intensity"),
        ((1.0, np.inf), "direction"),
        ((1.0, 0.0, np.zeros(3)), "start"),
    ],
)
def test_arguments_that_make_no_sense_are_refused(solver, arguments, message):
    with pytest.raises(ContractError, match=message):
        solver.solve(*arguments)
    with pytest.raises(ContractError, match="not finite"):
        solver.solve(1.0, 0.0, np.full(solver.unknowns, np.nan))


def test_building_on_the_rim_needs_an_outflow():
    cut = rectangle(10, 10, (100.0, 100.0), [(40.0, 80.0, 60.0, 100.0)])
    with pytest.raises(ConfigurationError, match="got one with 20 m missing"):
        WindSolver(cut, WindOptions())
    solver = WindSolver(cut, WindOptions(boundary="outflow"))
    assert solver.solve(2.0, 0.0).residual <= 1e-8
