"""``run.dafw`` of real runs and sweeps: ERR is the run's own, xugrid draws every field, a sweep becomes a table."""

import json
import shutil

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray

import dafw
from dafw import RunError
from dafw.commands import main
from dafw.core.accessor.contents import state_variables

MESH = ["model.site.bounds=[7.995,50.0005,7.9975,50.0022]", "model.mesh.wall_size=30", "model.mesh.across=1"]
WORDS = [*MESH, "model.release=[-6,-45]", "vehicle.start=[[-6,-20]]", "section=[]", "policy=stationary", "model=ad"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of a small run on a mesh, with all members."""
    folder = tmp_path_factory.mktemp("run") / "it"
    words = [*WORDS, "model.mesh.far_size=60", "members=4", "cycles=3", "record.members=all", "pictures=false"]
    assert main(["run", *words, f"hydra.run.dir={folder}"]) == 0
    return folder


@pytest.fixture(scope="module")
def sweep_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep") / "it"
    small = ["experiment=lorenz96", "pictures=false", "cycles=2", "model.spinup=10", "model.size=6", "members=4"]
    words = ["run", "-m", *small, "filter=etkf,enkf", "seed=3,1", f"hydra.sweep.dir={folder}"]
    assert main(words) == 0
    return folder


def test_opening_a_run_brings_the_accessor_and_its_err_is_the_runs_own(folder):
    with dafw.open_run(folder) as run:
        for of, name in {"belief": "err", "forecast": "err_forecast", "free": "err_free"}.items():
            xarray.testing.assert_identical(run.dafw.err(of=of), run[name])
            fields = run.drop_vars(name)  # then it is computed from the fields, which are in single precision
            np.testing.assert_allclose(fields.dafw.err(of=of)[1:], run[name][1:], rtol=1e-5)
        np.testing.assert_allclose(run.dafw.rmse(), run["rmse"], rtol=1e-5)


def test_moments_of_the_recorded_members_are_the_recorded_moments(folder):
    with dafw.open_run(folder) as run:
        names = state_variables(run)
        assert names[0] == "concentration" and {f"{name}_members" for name in names} <= set(run)
        for name in names:
            np.testing.assert_allclose(run.dafw.mean(name), run[f"{name}_mean"], rtol=1e-5, atol=1e-7)
            np.testing.assert_allclose(run.dafw.spread(name), run[f"{name}_spread"], rtol=1e-4, atol=1e-6)
        off = np.abs(run["concentration_members"] - run["concentration_truth"]).mean("member")
        assert (run.dafw.crps(each=True) <= off + 1e-12).all()


def test_the_surprises_of_a_cycle_have_the_recorded_mean_and_root_mean_square(folder):
    with dafw.open_run(folder) as run:
        surprise = run.dafw.surprise()
        assert int(surprise.notnull().sum()) > 0
        np.testing.assert_allclose(surprise.mean("observation"), run["innovation_mean"])
        np.testing.assert_allclose(np.sqrt((surprise**2).mean("observation")), run["innovation_rms"])


def test_xugrid_opens_and_draws_every_field_of_a_run(folder):
    import xugrid

    with xarray.open_dataset(folder / "run.nc", decode_times=False) as run:
        fields = [str(name) for name in run.data_vars if run[name].attrs.get("mesh") == "mesh2d"]
        assert {"concentration_mean", "concentration_truth", "concentration_members"} <= set(fields)
        grid = xugrid.UgridDataset(run)
        for name in fields:
            values = grid[name].isel(time=-1)
            values = values.isel(member=0) if "member" in values.dims else values
            drawn = values.ugrid.plot()
            assert drawn.get_array().size in (run.sizes["node"], run.sizes["face"])
            plt.close("all")


def test_a_sweep_is_a_table(sweep_folder):
    with dafw.open_sweep(sweep_folder) as sweep:
        table = sweep.dafw.table()
        assert table[["filter", "seed"]].values.tolist() == [[f, s] for f in ("etkf", "enkf") for s in (3, 1)]
        for _, row in table.iterrows():
            summary = json.loads((sweep_folder / row["folder"] / "summary.json").read_text())
            assert row["err_final"] == summary["err_final"] and row["cycles"] == 2 and row["status"] == "complete"
            assert row["readings_on_time"] == summary["readings"]["on_time"]
            assert row["err_final"] == sweep["err"].sel(filter=row["filter"], seed=row["seed"])[-1]
        assert np.isnan(table["diverged_at"]).all()
        assert table.groupby("filter")["err_final"].median().size == 2
        chosen = sweep.sel(filter="enkf").dafw.table()
        assert chosen["filter"].tolist() == ["enkf"] * 2 and chosen["seed"].tolist() == [3, 1]


def test_a_table_has_a_row_for_a_run_that_left_nothing(sweep_folder, tmp_path):
    copy = shutil.copytree(sweep_folder, tmp_path / "copy")
    (gone,) = [run for run in copy.glob("*/") if "etkf" in run.name and "seed=1" in run.name]
    shutil.rmtree(gone)
    with dafw.open_sweep(copy) as sweep:
        table = sweep.dafw.table()
        assert table["status"].tolist() == ["complete", "missing", "complete", "complete"]
        assert np.isnan(table["err_final"]).tolist() == [False, True, False, False]


def test_scores_of_a_sweep_have_its_parameters(sweep_folder):
    with dafw.open_sweep(sweep_folder) as sweep:
        rmse = sweep.dafw.rmse()
        assert rmse.dims == ("filter", "seed", "time") and rmse.chunks is not None
        np.testing.assert_allclose(rmse, sweep["rmse"], rtol=1e-5)


def test_a_run_is_no_table(folder):
    with dafw.open_run(folder) as run, pytest.raises(RunError, match=r"a table needs a sweep"):
        run.dafw.table()
