"""The winds of a basis: the same bits for any number of processes; winds without a solution are left out."""

import json
import logging
import signal

import numpy as np
import pytest
from waiting import PATIENCE, children, ended, halted

from dafw.core import workers
from dafw.core.options import build as built
from dafw.plugins.models.dispersion.model_ins import AdvectionDiffusionINS
from dafw.plugins.models.dispersion.reduced_wind import snapshots as module
from dafw.plugins.models.dispersion.reduced_wind.choice import build
from dafw.plugins.models.dispersion.reduced_wind.snapshots import row, snapshots
from dafw.plugins.models.dispersion.wind.options import BasisOptions, WindOptions
from dafw.plugins.models.dispersion.wind.solution import WindError
from dafw.plugins.models.dispersion.wind.solver import WindSolver

BASIS = BasisOptions(directions=5, levels=2, max_intensity=4.0, modes=20)


@pytest.fixture(scope="module")
def mesh(small_model):
    return built(AdvectionDiffusionINS, small_model, "model 'test'").tagged_mesh


def with_cores(monkeypatch, count):
    monkeypatch.setattr(workers, "cores", lambda: count)
    monkeypatch.setattr(module, "SMALL", 0)


@pytest.mark.parametrize("levels", [1, 2])
def test_a_derivative_reaches_half_way_to_the_next_wind(mesh, levels):
    basis = BasisOptions(directions=4, levels=levels, max_intensity=4.0)
    solver = WindSolver(mesh, WindOptions(basis=basis, keep_factorisation=False))  # kept ones are inexact
    found = row(solver, 0.3)
    by_reynolds = found.derivatives[:, -2]  # at the strongest wind
    step = 1e-3
    weaker, stronger = (solver.problem.velocity(solver.solve(4.0 * (1 + s), 0.3).unit) for s in (-step, step))
    expected = (stronger - weaker) / (2 * step) / levels  # R d/dR, times the share of R that lies half a cell away
    assert np.linalg.norm(by_reynolds - expected) < 1e-4 * np.linalg.norm(expected)


def test_where_there_is_one_reynolds_number_nothing_lies_beyond_it(mesh):
    options = WindOptions(closure="proportional", basis=BasisOptions(directions=4, levels=3))
    found = row(WindSolver(mesh, options), 0.3)
    assert found.derivatives.shape[1] == 2
    assert not found.derivatives[:, 0].any() and found.derivatives[:, 1].any()


def test_little_work_is_done_here(mesh, caplog):
    caplog.set_level(logging.INFO, "dafw")
    snapshots(WindSolver(mesh, WindOptions(basis=BasisOptions(directions=4, levels=1, max_intensity=1.0))), mesh.file)
    assert "solving 4 winds, processes: 1" in caplog.text


def test_a_basis_is_the_same_bits_however_many_processes_solved_its_winds(mesh, monkeypatch, caplog):
    caplog.set_level(logging.INFO, "dafw")
    bases = []
    for count in (1, 2, 7):
        with_cores(monkeypatch, count)
        bases.append(build(mesh, WindOptions(basis=BASIS)))
    assert [f"solving 10 winds, processes: {count}" in caplog.text for count in (1, 2, 5)] == [True] * 3
    for name, array in bases[0].arrays().items():
        for other in bases[1:]:
            np.testing.assert_array_equal(other.arrays()[name], array)


def test_a_worker_of_an_executor_solves_all_winds_itself(mesh, monkeypatch, caplog):
    caplog.set_level(logging.INFO, "dafw")
    with_cores(monkeypatch, 2)
    few = WindOptions(basis=BasisOptions(directions=4, levels=1, max_intensity=1.0))
    made = workers.outcome("a test", lambda: snapshots(WindSolver(mesh, few), mesh.file)).get()
    assert made.winds.shape[1] == 4 and made.derivatives.shape[1] == 8
    assert "solving 4 winds, processes: 1" in caplog.text


@pytest.mark.parametrize("count", [1, 2])
def test_a_wind_that_cannot_be_solved_ends_its_row(mesh, monkeypatch, caplog, count):
    caplog.set_level(logging.INFO, "dafw")
    with_cores(monkeypatch, count)
    weak = WindOptions(
        viscosity=20.0,
        max_iterations=2,
        max_steps=1,
        basis=BasisOptions(directions=4, levels=3, max_intensity=300.0, modes=20),
    )
    strong = WindOptions(
        viscosity=1e-3, max_iterations=1, max_steps=1, basis=BasisOptions(directions=4, levels=2, modes=20)
    )
    found = snapshots(WindSolver(mesh, weak), mesh.file)
    assert 0 < len(found.parameters) < 12
    assert "no solution for intensity" in caplog.text
    with pytest.raises(WindError, match=r"^reduced basis: none of its 8 winds can be solved"):
        snapshots(WindSolver(mesh, strong), mesh.file)


HALTING = """
import sys
from functools import partial
from waiting import halt_task
from dafw.commands import main
from dafw.plugins.models.dispersion.reduced_wind import snapshots
snapshots._row_in_worker = partial(halt_task, sys.argv[1])
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.skipif(workers.cores() < 2, reason="a single core has no workers")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_run_that_is_stopped_while_it_makes_its_basis_leaves_no_process(tmp_path, monkeypatch, number):
    monkeypatch.setenv("DAFW_CACHE", str(tmp_path / "cache"))
    (tmp_path / "halting.py").write_text(HALTING)
    mesh = ["model.mesh.wall_size=40", "model.mesh.far_size=60"]
    basis = ["model.wind.solver=reduced", "model.wind.basis.directions=2000", "model.wind.basis.levels=9"]
    words = ["halting.py", str(tmp_path / "halt"), "run", "experiment=enie2d", *mesh, *basis]
    with halted(words, tmp_path, waiting=2) as run:
        helpers = children(run.pid)
        run.send_signal(number)
        _, error = run.communicate(timeout=PATIENCE)
    assert len(helpers) >= 2 and ended(helpers)
    (summary,) = tmp_path.glob("outputs/*/*/summary.json")
    assert json.loads(summary.read_text())["status"] == "interrupted"
    if number != signal.SIGKILL:
        assert run.returncode == 130
        assert "interrupted" in error and "Traceback" not in error
        assert not list((tmp_path / "cache").glob("**/making-*"))
