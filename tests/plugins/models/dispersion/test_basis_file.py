"""Reduced bases on disk: whole, shared, enriched by several processes, made anew where damaged."""

import logging
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from flow_meshes import rectangle

from dafw.core.errors import ConfigurationError
from dafw.plugins.models.dispersion.basis_cache import key
from dafw.plugins.models.dispersion.basis_file import BasisStore
from dafw.plugins.models.dispersion.reduced_flow import ReducedBasis
from dafw.plugins.models.dispersion.wind import BasisOptions, WindOptions, wind_solver

OPTIONS = WindOptions(
    viscosity=20.0, solver="reduced", basis=BasisOptions(directions=4, levels=1, max_intensity=1.0, modes=10)
)


@pytest.fixture(scope="module")
def block():
    return rectangle(5, 5, (100.0, 100.0), [(40.0, 40.0, 60.0, 60.0)])


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("DAFW_CACHE", str(tmp_path))
    return tmp_path


@pytest.fixture
def basis():
    rng = np.random.default_rng(0)
    shapes = [(12, 4), (2, 4, 4), (4, 4), (3, 4), (3, 10), (5, 2), (5, 2)]
    return ReducedBasis(*(rng.normal(size=shape) for shape in shapes))


def only_folder(cache):
    (folder,) = cache.glob("wind-basis-*")
    return folder


def test_what_was_saved_is_loaded(tmp_path, basis):
    store = BasisStore(tmp_path)
    assert store.newest() is None
    digest = store.save(basis)
    found, loaded = store.newest()
    assert found == digest == store.save(basis)
    for name, array in basis.arrays().items():
        np.testing.assert_array_equal(loaded.arrays()[name], array)


def test_a_basis_stays_when_a_newer_one_comes(tmp_path, basis):
    store = BasisStore(tmp_path)
    old = store.save(basis)
    new = store.save(replace(basis, gram=2.0 * basis.gram))
    assert store.newest()[0] == new != old
    np.testing.assert_array_equal(store.load(old).gram, basis.gram)


def test_a_basis_that_is_not_there_is_a_wrong_request(tmp_path):
    with pytest.raises(ConfigurationError, match="basis abc is not in the cache"):
        BasisStore(tmp_path).load("abc")


@pytest.mark.parametrize("damage", [lambda c: c[: len(c) // 2], lambda c: b"something else", lambda c: c[:-1] + b"x"])
def test_a_damaged_basis_is_made_anew_with_a_line_in_the_log(block, cache, caplog, damage):
    digest = wind_solver(block, OPTIONS).digest
    file = only_folder(cache) / f"{digest}.npz"
    file.write_bytes(damage(file.read_bytes()))
    with caplog.at_level(logging.WARNING):
        assert wind_solver(block, OPTIONS).digest == digest  # the same winds, the same bits
    assert "is damaged" in caplog.text and "made anew" in caplog.text


def test_a_basis_is_made_once(block, cache):
    digest = wind_solver(block, OPTIONS).digest
    file = only_folder(cache) / f"{digest}.npz"
    made = file.stat().st_mtime_ns
    assert wind_solver(block, OPTIONS).digest == digest
    assert file.stat().st_mtime_ns == made


def test_another_mesh_or_option_is_another_basis(block):
    other = rectangle(5, 5, (100.0, 101.0), [(40.0, 40.4, 60.0, 60.6)])
    names = {key(block, OPTIONS), key(other, OPTIONS), key(block, replace(OPTIONS, viscosity=21.0))}
    assert len(names) == 3
    trusting = replace(OPTIONS, solver="accelerated", basis=replace(OPTIONS.basis, tolerance=0.1, digest="x"))
    assert key(block, trusting) == key(block, OPTIONS)


def test_winds_solved_in_full_enrich_the_next_basis_and_not_the_one_in_use(block, cache):
    solver = wind_solver(block, OPTIONS)
    strong = solver.solve(6.0, 0.5)
    assert not solver.trusts(strong.unit)
    assert solver.solve(6.0, 0.5).unit.size == strong.unit.size
    pinned = replace(OPTIONS, basis=replace(OPTIONS.basis, digest=solver.digest))
    assert wind_solver(block, pinned).digest == solver.digest
    assert len(list((only_folder(cache) / "waiting").iterdir())) == 1
    richer = wind_solver(block, OPTIONS)
    assert richer.digest != solver.digest
    assert not list((only_folder(cache) / "waiting").iterdir())
    found = richer.solve(6.0, 0.5)
    assert richer.trusts(found.unit)
    wind, full = richer.velocity(found).x.array, solver.velocity(strong).x.array
    assert np.linalg.norm(wind - full) < 1e-5 * np.linalg.norm(full)
    assert wind_solver(block, pinned).digest == solver.digest  # who wants the old one still has it


def test_a_wind_that_cannot_be_read_is_put_away(block, cache, caplog):
    digest = wind_solver(block, OPTIONS).digest
    waiting = only_folder(cache) / "waiting"
    waiting.mkdir()
    (waiting / "half.npz").write_bytes(b"PK\x03\x04 half a file")
    BasisStore(only_folder(cache)).submit(0.1, 0.2, np.zeros(3))
    assert wind_solver(block, OPTIONS).digest == digest
    assert not list(waiting.iterdir())
    assert caplog.text.count("cannot be used") == 2


WORKER = """
import sys
import numpy as np
from pathlib import Path
from dafw.plugins.models.dispersion.basis_file import BasisStore
store = BasisStore(Path(sys.argv[1]))
for k in range(20):
    store.submit(0.1 * k, float(sys.argv[2]), np.full(6, float(sys.argv[2])))
    with store.lock():
        count = Path(sys.argv[1]) / "count"
        count.write_text(str(int(count.read_text()) + 1))
"""


def test_two_processes_at_once_lose_nothing(tmp_path):
    (tmp_path / "count").write_text("0")
    workers = [subprocess.Popen([sys.executable, "-c", WORKER, str(tmp_path), str(k)]) for k in (1, 2)]
    assert [worker.wait(60) for worker in workers] == [0, 0]
    assert (tmp_path / "count").read_text() == "40"
    winds = BasisStore(tmp_path).waiting(6, 100)
    assert sorted((round(w.parameters[0] / 0.1), w.parameters[1]) for w in winds) == sorted(
        (k, d) for k in range(20) for d in (1.0, 2.0)
    )
    assert all((wind.velocity == wind.parameters[1]).all() for wind in winds)
    assert not list(tmp_path.glob("**/making-*"))
