"""A run uses one basis: belief, truth and free run share it; its digest is in the run's file and repeats the run."""

import json

import netCDF4
import numpy as np
import pytest
from run_files import contents
from small_study import small_study

from dafw.core.errors import ConfigurationError
from dafw.core.sharing import Shared
from dafw.plugins.models.dispersion import model_ins
from dafw.plugins.models.dispersion.site import site
from dafw.plugins.models.dispersion.site.site import load_site
from dafw.studies.running import run_study

BASIS = {"directions": 4, "levels": 1, "max_intensity": 3.0, "modes": 20, "tolerance": 0.02}


@pytest.fixture
def study(small_model, tmp_path, monkeypatch):
    monkeypatch.setenv("DAFW_CACHE", str(tmp_path / "cache"))

    def make(digest="", executor="serial", truth=None, enrich=False, transport=None, **wind):
        options = {"solver": "reduced", "basis": BASIS | {"digest": digest, "enrich": enrich}}
        model = small_model | {"wind": options | wind, "transport": transport or {}}
        truth = {"wind_speed": 2.0, "transport": {"diffusion": 0.8}, **(truth or {})}
        return small_study(model, truth, {"name": executor}, members=4, cycles=3)

    return make


def outside(solver):
    """Let the solver solve a wind that its basis does not represent."""
    found = solver.solve(9.0, 0.7)
    assert not solver.trusts(found.unit)


def test_belief_truth_and_free_run_share_what_is_the_same(study):
    parts, _ = study().prepare()
    assert parts.model.solver is parts.truth.solver is parts.free.solver
    assert parts.model._reduced_advection is parts.truth._reduced_advection
    assert parts.model.tagged_mesh is parts.truth.tagged_mesh is parts.free.tagged_mesh
    other, _ = study(truth={"wind": {"viscosity": 30.0}}).prepare()
    assert other.model.solver is not other.truth.solver
    assert other.model.tagged_mesh is other.truth.tagged_mesh is not parts.model.tagged_mesh  # another run
    assert other.model.solver.digest != other.truth.solver.digest


def test_one_site_and_one_list_of_nodes_for_all(study, monkeypatch):
    read = []
    monkeypatch.setattr(site, "load_site", lambda options: read.append(options) or load_site(options))
    parts, _ = study(solver="newton").prepare()
    assert len(read) == 1
    assert parts.model.space.variables[0].coordinates is parts.free.space.variables[0].coordinates
    finer = {"mesh": {"wall_size": 9.0}}
    seen = study(truth=finer, solver="newton").prepare()[0].truth_view  # the same site, another mesh
    assert len(read) == 2 and seen.matrix.shape[1] > seen.matrix.shape[0]
    study(truth={"site": {"rim": 21.0}}, solver="newton").prepare()
    assert len(read) == 4


def test_a_run_that_enriches_has_one_basis_and_the_next_the_newest(study):
    first, _ = study(enrich=True).prepare()
    outside(first.model.solver)
    second, _ = study(enrich=True).prepare()  # in the same process, while the first still exists
    assert second.model.solver.digest != first.model.solver.digest  # the basis now has the wind,
    assert first.truth.solver.digest == first.model.solver.digest  # but the first run still uses the old basis


@pytest.mark.parametrize("executor", ["serial", "processes"])
def test_the_same_study_twice_gives_the_same_bits(study, tmp_path, executor):
    summary = run_study(study(executor=executor), tmp_path / "first")
    (folder,) = (tmp_path / "cache").glob("wind-basis-*")
    on_disk = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with netCDF4.Dataset(tmp_path / "first" / "run.nc") as file:
        assert (file["wind_speed_members"][1:] > BASIS["max_intensity"]).any()  # winds that are not in the basis
    assert run_study(study(executor=executor), tmp_path / "second")["pinned"] == summary["pinned"]
    assert contents(tmp_path / "second") == contents(tmp_path / "first")
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == on_disk

    run_study(study(executor=executor, enrich=True), tmp_path / "leaving winds")
    assert contents(tmp_path / "leaving winds") == contents(tmp_path / "first")  # nothing has enriched the basis yet
    richer = run_study(study(executor=executor, enrich=True), tmp_path / "richer")
    digest = richer["pinned"]["model"]["wind"]["basis"]["digest"]
    assert digest != summary["pinned"]["model"]["wind"]["basis"]["digest"]
    assert contents(tmp_path / "richer") != contents(tmp_path / "first")
    assert modes(folder, digest) > modes(folder, (folder / "made").read_text())
    run_study(study(executor=executor), tmp_path / "third")  # winds that others added change nothing
    assert contents(tmp_path / "third") == contents(tmp_path / "first")


def modes(folder, digest):
    """Return the number of modes of a basis."""
    with np.load(folder / f"{digest}.npz") as arrays:
        return len(arrays["quadratic"])


def test_sharing_changes_no_bit(study, tmp_path, monkeypatch):
    summary = run_study(study(), tmp_path / "shared")
    digest = summary["pinned"]["model"]["wind"]["basis"]["digest"]
    with monkeypatch.context() as patch:
        apart = property(lambda self: Shared(), lambda *_: None)
        patch.setattr(model_ins.AdvectionDiffusionINS, "_shared", apart, raising=False)
        parts, _ = study(digest).prepare()
        assert parts.model.solver is not parts.truth.solver
        run_study(study(digest), tmp_path / "apart")
    assert contents(tmp_path / "shared") == contents(tmp_path / "apart")


@pytest.mark.parametrize("executor", ["serial", "processes"])
def test_the_digest_in_the_file_gives_the_run_again(study, tmp_path, executor):
    summary = run_study(study(executor=executor, enrich=True), tmp_path / "first")
    with netCDF4.Dataset(tmp_path / "first" / "run.nc") as file:
        pinned = {role: json.loads(file.getncattr(f"{role}_pinned")) for role in ("model", "truth", "free")}
    assert summary["pinned"] == pinned
    assert json.loads((tmp_path / "first" / "summary.json").read_text())["pinned"] == pinned
    digest = pinned["model"]["wind"]["basis"]["digest"]
    assert pinned["truth"] == pinned["free"] == {"wind": {"basis": {"digest": digest}}}
    newer = run_study(study(enrich=True), tmp_path / "newer")  # winds of the first run are in the basis of this one
    assert newer["pinned"]["model"] != pinned["model"]
    assert contents(tmp_path / "newer") != contents(tmp_path / "first")
    run_study(study(digest), tmp_path / "again")
    assert contents(tmp_path / "again") == contents(tmp_path / "first")


@pytest.mark.parametrize("role", ["model", "truth"])
def test_a_basis_that_is_not_there_is_refused_before_anything_is_made(study, tmp_path, role):
    absent = "0" * 32
    asked = study(absent) if role == "model" else study(truth={"wind": {"basis": {"digest": absent}}})
    whose = "" if role == "model" else "truth: "
    with pytest.raises(ConfigurationError, match=f"^{whose}model 'ad_ins': wind: the reduced basis {absent} is not in"):
        run_study(asked, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_damaged_basis_is_refused_before_anything_is_made(study, tmp_path):
    parts, _ = study().prepare()
    digest = parts.model.solver.digest
    (file,) = (tmp_path / "cache").glob(f"*/{digest}.npz")
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(ConfigurationError, match="is damaged; delete it"):
        run_study(study(digest), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_model_that_leaves_nothing_open_has_nothing_pinned(study, tmp_path):
    plain = study(solver="newton")
    assert run_study(plain, tmp_path / "plain")["pinned"] == {}
    with netCDF4.Dataset(tmp_path / "plain" / "run.nc") as file:
        assert not [name for name in file.ncattrs() if name.endswith("_pinned")]


def test_threads_change_no_bit(study, tmp_path, monkeypatch):
    flux_corrected = {"scheme": "fct", "solver": "direct", "outflow": "open"}
    for name, cores in (("one", 1), ("three", 3)):
        monkeypatch.setattr(model_ins, "spare_cores", lambda cores=cores: cores)
        run_study(study(transport=flux_corrected), tmp_path / name)
    assert contents(tmp_path / "one") == contents(tmp_path / "three")
