"""The winds of a basis: the same bits however many processes solve them, and what becomes of those without solution."""

import logging

import numpy as np
import pytest

from dafw.core import workers
from dafw.core.options import build as built
from dafw.plugins.models.dispersion import snapshots as module
from dafw.plugins.models.dispersion.model_ins import AdvectionDiffusionINS
from dafw.plugins.models.dispersion.reduced_basis import build
from dafw.plugins.models.dispersion.snapshots import snapshots
from dafw.plugins.models.dispersion.wind import BasisOptions, WindError, WindOptions, WindSolver

BASIS = BasisOptions(directions=5, levels=2, max_intensity=4.0, modes=20)


@pytest.fixture(scope="module")
def mesh(small_model):
    return built(AdvectionDiffusionINS, small_model, "model 'test'").tagged_mesh


def with_cores(monkeypatch, count):
    monkeypatch.setattr(workers, "cores", lambda: count)
    monkeypatch.setattr(module, "SMALL", 0)


def test_little_work_is_done_here(mesh, caplog):
    caplog.set_level(logging.INFO, "dafw")
    snapshots(WindSolver(mesh, WindOptions(basis=BasisOptions(directions=4, levels=1, max_intensity=1.0))), mesh.file)
    assert "solving 4 winds, processes: 1" in caplog.text


def test_a_basis_is_the_same_bits_however_many_processes_solved_its_winds(mesh, monkeypatch, caplog):
    caplog.set_level(logging.INFO, "dafw")
    bases = []
    for count in (1, 2, 7):
        with_cores(monkeypatch, count)
        bases.append(build(WindSolver(mesh, WindOptions(basis=BASIS)), mesh.file))
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
