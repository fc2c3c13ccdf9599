"""A study around buildings gives the same file with every executor, and after any earlier runs."""

import netCDF4
import pytest
from run_files import contents
from small_study import small_study

from dafw.studies.running import run_study


@pytest.fixture(scope="module")
def study(small_model):
    def make(executor, seed=0):
        often = {"speed_threshold": 0.01, "direction_threshold": 0.005}
        return small_study(small_model | often, {"wind_speed": 4.0}, executor, seed=seed, members=5, cycles=6)

    return make


@pytest.fixture(scope="module")
def alone(study, tmp_path_factory):
    """The file of the serial executor, the first run of its process."""
    folder = tmp_path_factory.mktemp("alone") / "run"
    run_study(study({"name": "serial"}), folder)
    return contents(folder)


def test_the_study_solves_winds_anew_in_most_cycles(study, alone, tmp_path):
    run_study(study({"name": "serial"}), tmp_path / "again")
    assert contents(tmp_path / "again") == alone
    with netCDF4.Dataset(tmp_path / "again" / "run.nc") as file:
        assert (file["model_wind_solved"][2:].sum(axis=1) > 0).sum() >= 2


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_processes_give_the_same_bits(study, alone, tmp_path, workers):
    run_study(study({"name": "processes", "workers": workers}), tmp_path / "run")
    assert contents(tmp_path / "run") == alone


def test_a_cluster_that_has_run_something_else_gives_the_same_bits(study, alone, tmp_path):
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=":0") as cluster:
        dask = {"name": "dask", "address": cluster.scheduler_address, "workers": 1}
        run_study(study(dask, seed=1), tmp_path / "other")
        run_study(study(dask | {"workers": None}), tmp_path / "run")
    assert contents(tmp_path / "other") != alone
    assert contents(tmp_path / "run") == alone


def test_members_that_are_solved_directly_have_the_same_bits_everywhere(small_model, tmp_path):
    direct = small_model | {"transport": {"solver": "direct", "scheme": "fct"}}
    for executor in ({"name": "serial"}, {"name": "processes", "workers": 2}):
        run_study(small_study(direct, {"wind_speed": 4.0}, executor, members=5, cycles=4), tmp_path / executor["name"])
    assert contents(tmp_path / "serial") == contents(tmp_path / "processes")
