"""One dataset over a multirun: typed dimensions, missing runs tolerated, nothing read before it is used."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray

import dafw
from dafw import RunError, open_run, open_sweep
from dafw.commands import main

SMALL = ["experiment=lorenz96", "pictures=false", "cycles=2", "model.spinup=10", "model.size=6", "members=4"]


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """Return a function that runs a multirun, by default of small runs, and returns its folder."""

    def run(*words):
        folder = tmp_path_factory.mktemp("sweep") / "it"
        small = [word for word in SMALL if word.partition("=")[0] not in [given.partition("=")[0] for given in words]]
        assert main(["run", "-m", *small, *words, f"hydra.sweep.dir={folder}"]) == 0
        return folder

    return run


@pytest.fixture(scope="module")
def mixed(swept):
    """Return a multirun over plugins, integers and real numbers."""
    return swept("filter=etkf,enkf", "seed=3,1", "filter.inflation=1,1.05")


def single(folder, **chosen):
    """Return the folder of the one run with the chosen values."""
    wanted = {f"{name}={value}" for name, value in chosen.items()}
    (found,) = [run for run in folder.glob("*/") if wanted <= set(run.name.split(","))]
    return found


def copy_of(folder, tmp_path):
    """Return a copy, which a test may damage."""
    return Path(shutil.copytree(folder, tmp_path / "copy"))


def test_swept_parameters_are_dimensions_of_the_right_type(mixed):
    with open_sweep(mixed) as sweep:
        assert list(sweep.status.dims) == ["filter", "seed", "filter.inflation"]
        assert sweep["filter"].values.tolist() == ["etkf", "enkf"]
        assert sweep["seed"].dtype == np.int64 and sweep["seed"].values.tolist() == [3, 1]
        assert sweep["filter.inflation"].dtype == np.float64
        assert (sweep.status == "complete").all() and "pictures" not in sweep.dims


def test_yes_and_no_are_booleans_and_anything_else_is_text(swept):
    with open_sweep(swept("filter.rotation=true,false", "free={},null")) as sweep:
        assert sweep["free"].values.tolist() == ["{}", "null"] and sweep["x_free"].sel(free="null").isnull().all()
        assert sweep["filter.rotation"].dtype == np.bool_ and sweep["filter.rotation"].values.tolist() == [True, False]


def test_every_run_is_at_its_place(mixed):
    with open_sweep(mixed) as sweep:
        for name in ("etkf", "enkf"):
            for seed in (1, 3):
                chosen = {"filter": name, "seed": seed, "filter.inflation": 1.05}
                one = sweep.sel(chosen)
                with dafw.open_run(mixed / str(one.folder.values)) as run:
                    xarray.testing.assert_identical(one["x_mean"].reset_coords(drop=True), run["x_mean"].load())
                    assert one["x_mean"].dtype == run["x_mean"].dtype
                    assert json.loads(run.attrs["parts"])["filter"] == name and run.attrs["seed"] == seed
        assert sweep.attrs["scored_variable"] == "x" and "seed" not in sweep.attrs


def test_nothing_is_read_before_it_is_asked_for(mixed):
    with open_sweep(mixed) as sweep:
        assert all(sweep[name].chunks is not None for name in ("x_mean", "err", "observation_value"))
        assert max(sweep["x_mean"].chunks[0]) == 1


def test_a_run_that_was_never_begun_is_missing(mixed, tmp_path):
    folder = copy_of(mixed, tmp_path)
    shutil.rmtree(single(folder, filter="enkf", seed=1, **{"filter.inflation": 1}))
    with open_sweep(folder) as sweep:
        lost = {"filter": "enkf", "seed": 1, "filter.inflation": 1.0}
        assert sweep.status.sel(lost) == "missing" and sweep.folder.sel(lost) == ""
        assert sweep["err"].sel(lost).isnull().all()
        assert int((sweep.status == "complete").sum()) == 7 and int(sweep["err"][..., 1:].isnull().sum()) == 2


def tear(file):
    """Damage a netCDF file so that HDF5 opens it, and then finds its variables unreadable."""
    whole = file.read_bytes()
    for place in range(0, len(whole) - 64, 64):
        file.unlink()
        file.write_bytes(whole[:place] + b"Z" * 64 + whole[place + 64 :])
        try:
            netCDF4.Dataset(file, keepweakref=True).close()
        except RuntimeError:
            return
        except OSError:
            continue


def test_failed_and_unreadable_runs_are_tolerated(mixed, tmp_path):
    folder = copy_of(mixed, tmp_path)
    failed, damaged, cut, torn = sorted(folder.glob("*/"))[:4]
    summary = json.loads((failed / "summary.json").read_text())
    (failed / "summary.json").write_text(json.dumps(summary | {"status": "failed"}))
    (failed / "run.nc").unlink()
    (damaged / "run.nc").write_bytes(b"nothing")
    (damaged / "summary.json").write_text("{")
    (cut / "summary.json").write_text(json.dumps(summary | {"status": "interrupted"}))
    tear(torn / "run.nc")
    with pytest.raises(RunError, match="cannot be read as netCDF"):
        open_run(torn)
    with open_sweep(folder) as sweep:
        at = {
            str(name): status for name, status in zip(sweep.folder.values.flat, sweep.status.values.flat, strict=True)
        }
        assert [at[run.name] for run in (failed, damaged, cut)] == ["failed", "failed", "interrupted"]
        assert at[torn.name] == "complete" and int(sweep["err"][..., -1].isnull().sum()) == 3


def test_a_multirun_that_left_no_run_has_its_statuses(mixed, tmp_path):
    folder = copy_of(mixed, tmp_path)
    for run in folder.glob("*/"):
        shutil.rmtree(run)
    with open_sweep(folder) as sweep:
        assert sweep.status.shape == (2, 2, 2) and (sweep.status == "missing").all()


def test_runs_of_other_sizes_are_filled_up(swept):
    with open_sweep(swept("members=4,7", "cycles=1,3", "record.members=all", "model.size=6,9")) as sweep:
        assert (sweep.sizes["member"], sweep.sizes["time"], sweep.sizes["node"]) == (7, 4, 9)
        small = sweep["x_members"].sel({"members": 4, "cycles": 1, "model.size": 6})
        assert small[:2, :4, :6].notnull().all() and int(small.notnull().sum()) == 2 * 4 * 6
        assert sweep["x_members"].sel({"members": 7, "cycles": 3, "model.size": 9}).notnull().all()
        assert np.allclose(sweep["time"], 0.05 * np.arange(4))


def test_other_models_have_their_own_variables_and_times(tmp_path):
    words = ["experiment=lorenz96,linear_advection", "cycles=2", "pictures=false", "members=45"]
    assert main(["run", "-m", *words, f"hydra.sweep.dir={tmp_path / 'it'}"]) == 0
    with open_sweep(tmp_path / "it") as sweep:
        assert sweep["x_mean"].sel(experiment="lorenz96").notnull().all()
        assert sweep["x_mean"].sel(experiment="linear_advection").isnull().all()
        assert sweep["u_mean"].sel(experiment="linear_advection").notnull().all()
        assert "time" not in sweep.coords
        assert sweep["row_time"].sel(experiment="linear_advection").values.tolist() == [0.0, 1.0, 2.0]
        assert np.allclose(sweep["row_time"].sel(experiment="lorenz96"), [0.0, 0.05, 0.1])


def test_what_is_the_same_in_all_runs_is_there_once(tmp_path):
    mesh = ["model.site.bounds=[7.995,50.0005,7.9975,50.0022]", "model.mesh.wall_size=30", "model.mesh.across=1"]
    words = [*mesh, "model.release=[-6,-45]", "vehicle.start=[[-6,-20]]", "section=[]", "policy=stationary", "model=ad"]
    words += ["members=3", "cycles=1", "pictures=false"]
    for name, more in {
        "seeds": ["model.mesh.far_size=60", "seed=0,1"],
        "meshes": ["model.mesh.far_size=60,45"],
    }.items():
        assert main(["run", "-m", *words, *more, f"hydra.sweep.dir={tmp_path / name}"]) == 0
    with open_sweep(tmp_path / "seeds") as sweep:
        assert sweep["node_x"].dims == ("node",) and sweep["mesh2d_face_nodes"].dims == ("face", "face_corner")
        assert sweep["mesh2d_face_nodes"].dtype.kind == "i" and "node_x" in sweep.coords
    with open_sweep(tmp_path / "meshes") as sweep:
        assert sweep["node_x"].dims == ("model.mesh.far_size", "node")
        counts = sweep["node_x"].notnull().sum("node").values.tolist()
        assert max(counts) == sweep.sizes["node"] and len(set(counts)) == 2
        for size, count in zip((60, 45), counts, strict=True):
            with dafw.open_run(
                tmp_path / "meshes" / str(sweep.folder.sel({"model.mesh.far_size": size}).values)
            ) as run:
                assert count == run.sizes["node"]


def test_a_multirun_of_one_run_has_no_dimensions_of_its_own(swept):
    with open_sweep(swept("seed=5")) as sweep:
        assert sweep.status.dims == () and sweep.status == "complete" and sweep["err"].dims == ("time",)


def test_the_record_of_the_multirun_names_it_as_well(mixed):
    with open_sweep(mixed / "multirun.yaml") as sweep, open_sweep(str(mixed)) as same:
        xarray.testing.assert_identical(sweep["err"].load(), same["err"].load())


def test_what_is_no_multirun_is_refused(mixed, tmp_path):
    with pytest.raises(RunError, match=r"is a single run, not a multirun"):
        open_sweep(next(mixed.glob("*/")))
    for wrong in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(RunError, match="holds no multirun"):
            open_sweep(wrong)


def test_a_multirun_is_drawn_from_its_folder_and_from_all_that_is_in_it(mixed, tmp_path, capsys):
    folder = copy_of(mixed, tmp_path)
    (next(folder.glob("*/")) / "run.nc").unlink()
    capsys.readouterr()
    for words in ([folder], sorted(folder.iterdir()), [folder / "multirun.yaml"]):
        shutil.rmtree(tmp_path / "drawn", ignore_errors=True)
        assert main(["plot", *map(str, words), "--out", str(tmp_path / "drawn")]) == 0
        pictures = [str(tmp_path / "drawn" / f"{name}.png") for name in ("err", "innovations")]
        assert capsys.readouterr().out.splitlines() == pictures
    for run in folder.glob("*/run.nc"):
        run.unlink()
    assert main(["plot", str(folder)]) == 2
    assert "none of its runs has left anything to draw" in capsys.readouterr().err
