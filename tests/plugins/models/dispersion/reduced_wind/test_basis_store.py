"""Reduced bases on disk: complete, shared, enriched by several processes, made again if damaged."""

import logging
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flow_meshes import rectangle
from waiting import PATIENCE

from dafw.core.errors import ConfigurationError
from dafw.plugins.models.dispersion.mesh.generate import generate
from dafw.plugins.models.dispersion.mesh.options import MeshOptions
from dafw.plugins.models.dispersion.reduced_wind import store as store_module
from dafw.plugins.models.dispersion.reduced_wind.basis import ReducedBasis
from dafw.plugins.models.dispersion.reduced_wind.choice import key
from dafw.plugins.models.dispersion.reduced_wind.store import BasisStore
from dafw.plugins.models.dispersion.site.options import SiteOptions
from dafw.plugins.models.dispersion.site.site import load_site
from dafw.plugins.models.dispersion.wind.options import BasisOptions, WindOptions
from dafw.plugins.models.dispersion.wind_solvers import wind_solver

OPTIONS = WindOptions(
    viscosity=20.0, solver="reduced", basis=BasisOptions(directions=4, levels=1, max_intensity=1.0, modes=10)
)
ENRICH = replace(OPTIONS, basis=replace(OPTIONS.basis, enrich=True))


def plain_block():
    return rectangle(5, 5, (100.0, 100.0), [(40.0, 40.0, 60.0, 60.0)])


@pytest.fixture(scope="module")
def block():
    return plain_block()


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
    assert store.find("made") is None
    digest = store.save(basis, "made")
    found, loaded = store.find("made")
    assert found == digest == store.save(basis, "made")
    assert store.find("enriched") is None
    for name, array in basis.arrays().items():
        np.testing.assert_array_equal(loaded.arrays()[name], array)


def test_a_basis_stays_when_an_enriched_one_comes(tmp_path, basis):
    store = BasisStore(tmp_path)
    old = store.save(basis, "made")
    new = store.save(replace(basis, gram=2.0 * basis.gram), "enriched")
    assert store.find("enriched")[0] == new != old == store.find("made")[0]
    np.testing.assert_array_equal(store.load(old).gram, basis.gram)


def test_a_basis_that_is_not_there_is_a_wrong_request(tmp_path):
    with pytest.raises(ConfigurationError, match="basis abc is not in the cache"):
        BasisStore(tmp_path).load("abc")


def test_a_basis_of_another_key_is_not_taken_for_a_missing_one(tmp_path, basis):
    digest = BasisStore(tmp_path / "wind-basis-one").save(basis, "made")
    with pytest.raises(ConfigurationError, match=f"{digest} is one of another mesh or of other wind options"):
        BasisStore(tmp_path / "wind-basis-two").load(digest)


def test_a_name_that_leads_elsewhere_is_no_basis(tmp_path, basis):
    digest = BasisStore(tmp_path / "wind-basis-one").save(basis, "made")
    with pytest.raises(ConfigurationError, match="is not in the cache"):
        BasisStore(tmp_path / "wind-basis-two").load(f"../wind-basis-one/{digest}")


def test_a_basis_asked_for_by_name_must_be_whole(tmp_path, basis):
    store = BasisStore(tmp_path)
    digest = store.save(basis, "made")
    file = tmp_path / f"{digest}.npz"
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(ConfigurationError, match=f"the reduced basis .*{digest}.npz is damaged; delete it"):
        store.load(digest)


def test_a_basis_that_cannot_be_read_says_why(tmp_path):
    (tmp_path / f"{32 * 'a'}.npz").mkdir()
    with pytest.raises(ConfigurationError, match=r"a.npz cannot be read \(Is a directory\)$"):
        BasisStore(tmp_path).load(32 * "a")


def test_where_it_cannot_be_read_which_one_was_made_there_is_none(tmp_path, caplog):
    (tmp_path / "made").mkdir()
    assert BasisStore(tmp_path).find("made") is None
    assert "it is made anew" in caplog.text and "Is a directory" in caplog.text


def test_old_bases_that_nobody_used_for_weeks_go(tmp_path, basis, caplog):
    caplog.set_level(logging.INFO)
    store = BasisStore(tmp_path)
    made = store.save(replace(basis, gram=7.0 * basis.gram), "made")
    digests = [store.save(replace(basis, gram=k * basis.gram), "enriched") for k in range(5)]
    long_ago = time.time() - 1.1 * store_module.UNUSED
    for k, digest in enumerate([made, *digests]):
        os.utime(tmp_path / f"{digest}.npz", (long_ago, long_ago + k))
    store.load(digests[1])  # so this one was used recently
    newest = store.save(replace(basis, gram=9.0 * basis.gram), "enriched")
    left = {path.stem for path in tmp_path.glob("*.npz")}
    assert left == {made, digests[1], digests[3], digests[4], newest}
    assert caplog.text.count("is removed") == 2
    assert store.find("enriched")[0] == newest


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
    others = replace(OPTIONS.basis, tolerance=0.1, digest="x", enrich=True)
    trusting = replace(OPTIONS, solver="accelerated", basis=others)
    assert key(block, trusting) == key(block, OPTIONS)


def test_unless_one_asks_for_it_a_basis_stays_as_it_was_made(block, cache):
    solver = wind_solver(block, OPTIONS)
    before = {path: path.read_bytes() for path in only_folder(cache).rglob("*") if path.is_file()}
    assert not solver.trusts(solver.solve(6.0, 0.5).unit)
    assert {path: path.read_bytes() for path in only_folder(cache).rglob("*") if path.is_file()} == before
    enriching = wind_solver(block, ENRICH)
    enriching.solve(6.0, 0.5)
    assert wind_solver(block, ENRICH).digest != enriching.digest == solver.digest
    assert wind_solver(block, OPTIONS).digest == solver.digest


def test_winds_solved_in_full_enrich_the_next_basis_and_not_the_one_in_use(block, cache):
    solver = wind_solver(block, ENRICH)
    strong = solver.solve(6.0, 0.5)
    assert not solver.trusts(strong.unit)
    assert solver.solve(6.0, 0.5).unit.size == strong.unit.size
    pinned = replace(OPTIONS, basis=replace(OPTIONS.basis, digest=solver.digest))
    assert wind_solver(block, pinned).digest == solver.digest
    assert len(list((only_folder(cache) / "waiting").iterdir())) == 1
    richer = wind_solver(block, ENRICH)
    assert richer.digest != solver.digest
    assert not list((only_folder(cache) / "waiting").iterdir())
    found = richer.solve(6.0, 0.5)
    assert richer.trusts(found.unit)
    wind, full = richer.velocity(found).x.array, solver.velocity(strong).x.array
    assert np.linalg.norm(wind - full) < 1e-5 * np.linalg.norm(full)
    assert wind_solver(block, pinned).digest == solver.digest  # the old basis is still available by its digest


def test_a_wind_that_the_basis_knows_by_then_adds_nothing(block, cache):
    first = wind_solver(block, ENRICH)
    first.solve(6.0, 0.5)
    richer = wind_solver(block, ENRICH)
    late = wind_solver(block, replace(OPTIONS, basis=replace(ENRICH.basis, digest=first.digest)))
    late.solve(6.0, 0.5)  # a run that began earlier, with the same wind
    assert len(list((only_folder(cache) / "waiting").iterdir())) == 1
    assert wind_solver(block, ENRICH).digest == richer.digest
    assert not list((only_folder(cache) / "waiting").iterdir())


def test_a_cache_that_cannot_be_written_to_is_named_and_ends_no_run(tmp_path, caplog):
    (tmp_path / "file").touch()
    store = BasisStore(tmp_path / "file" / "key")
    with pytest.raises(ConfigurationError, match="wind: cannot write to the cache"), store.lock():
        pass
    store.submit(0.1, 0.0, np.zeros(6))
    assert "a wind that was solved in full is not kept for the next basis" in caplog.text


def test_no_more_winds_wait_than_can_be_used(tmp_path, monkeypatch):
    monkeypatch.setattr(store_module, "MOST_WAITING", 3)
    store = BasisStore(tmp_path)
    for k in range(5):
        store.submit(0.1 * k, 0.0, np.zeros(6))
    assert len(store.waiting(6, 100)) == 3


def test_a_wind_that_cannot_be_read_is_put_away(block, cache, caplog):
    digest = wind_solver(block, OPTIONS).digest
    waiting = only_folder(cache) / "waiting"
    waiting.mkdir()
    (waiting / "half.npz").write_bytes(b"PK\x03\x04 half a file")
    (waiting / "folder.npz").mkdir()
    BasisStore(only_folder(cache)).submit(0.1, 0.2, np.zeros(3))
    assert wind_solver(block, ENRICH).digest == digest
    assert [path.name for path in waiting.iterdir()] == ["folder.npz"]  # which is not a file of the store
    assert caplog.text.count("cannot be used") == 3


WORKER = """
import sys
import numpy as np
from pathlib import Path
from dafw.plugins.models.dispersion.reduced_wind.store import BasisStore
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
    assert [worker.wait(PATIENCE) for worker in workers] == [0, 0]
    assert (tmp_path / "count").read_text() == "40"
    winds = BasisStore(tmp_path).waiting(6, 100)
    assert sorted((round(w.parameters[0] / 0.1), w.parameters[1]) for w in winds) == sorted(
        (k, d) for k in range(20) for d in (1.0, 2.0)
    )
    assert all((wind.velocity == wind.parameters[1]).all() for wind in winds)
    assert not list(tmp_path.glob("**/making-*"))


def test_mesh_and_basis_tidy_up_after_the_dead(small_site, cache, basis):
    store = BasisStore(cache / "wind-basis-one")
    site, options = load_site(SiteOptions(**small_site)), MeshOptions(wall_size=20.0, far_size=40.0)
    name = dead(cache).name
    left = [store.folder / "waiting" / name, store.folder / name, cache / name]
    for path in left:
        path.mkdir(parents=True, exist_ok=True)
    store.save(basis, "made")
    assert [path.exists() for path in left] == [False, False, True]
    generate(site, options)
    assert not left[2].exists()


def dead(folder):
    """Return the unfinished folder that a killed process left."""
    code = "import os, sys; from pathlib import Path; from dafw.core.making import making; "
    code += "block = making(Path(sys.argv[1])); print(block.__enter__(), flush=True); os.kill(os.getpid(), 9)"
    made = subprocess.run([sys.executable, "-c", code, str(folder)], capture_output=True, text=True, timeout=PATIENCE)
    return Path(made.stdout.strip())


ENRICHING = """
import os, sys, time
from pathlib import Path
sys.path[:] = sys.argv[1].split(os.pathsep)
from test_basis_store import ENRICH, plain_block
from dafw.plugins.models.dispersion.wind_solvers import wind_solver
number, meeting = int(sys.argv[2]), Path(sys.argv[3])

def meet(purpose):
    (meeting / f"{purpose}-{number}").touch()
    while len(list(meeting.glob(f"{purpose}-*"))) < 2:
        time.sleep(0.001)

solver = wind_solver(plain_block(), ENRICH)
meet("solve")
assert not solver.trusts(solver.solve(6.0, float(number)).unit)
meet("enrich")
richer = wind_solver(plain_block(), ENRICH)
print(richer.digest, *(richer.trusts(richer.solve(6.0, float(n)).unit) for n in (1, 2)))
"""


def test_two_runs_that_enrich_at_once_both_get_both_winds(block, cache):
    plain = wind_solver(block, OPTIONS).digest
    meeting = cache / "meeting"
    meeting.mkdir()
    path = os.pathsep.join(sys.path)
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", ENRICHING, path, str(n), str(meeting)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )
        for n in (1, 2)
    ]  # fmt: skip
    said = [run.communicate(timeout=PATIENCE) for run in runs]
    assert [run.returncode for run in runs] == [0, 0], said
    newest = wind_solver(block, ENRICH).digest
    assert newest != plain
    assert [output.split() for output, _ in said] == [[newest, "True", "True"]] * 2
    folder = only_folder(cache)
    assert {path.stem for path in folder.glob("*.npz")} == {plain, newest}
    assert not list((folder / "waiting").iterdir()) and not list(folder.glob("**/making-*"))
