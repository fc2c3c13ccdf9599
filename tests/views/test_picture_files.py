"""Picture files: which ones a run gets, that they are whole, and what is said where there is no run."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from dafw.core.errors import RunError
from dafw.views import compare, draw_all, draw_runs, plot_route
from dafw.views.files import _save


def names(files):
    return [file.name for file in files]


def test_a_plant_gets_all_pictures_of_the_paper(plant_folder):
    files = draw_runs([plant_folder], None)
    assert names(files) == ["err.png", "route.png", "contours.png", "section.png", "parameters.png"]
    assert {file.parent for file in files} == {plant_folder / "figures"}
    assert sorted(names((plant_folder / "figures").iterdir())) == sorted(names(files))
    for file in files:
        pixels = imread(file)[..., :3]
        assert min(pixels.shape[:2]) > 300 and pixels.std() > 0.02


def test_a_ring_gets_only_what_makes_sense(ring_run, tmp_path):
    assert names(draw_all(ring_run, tmp_path)) == ["err.png", "state.png"]


def test_a_run_interrupted_before_its_first_cycle_is_drawn(plant_run, ring_run, tmp_path):
    first = draw_all(plant_run.isel(time=[0]), tmp_path / "plant")
    assert names(first) == ["err.png", "route.png", "contours.png", "parameters.png"]
    assert names(draw_all(ring_run.isel(time=[0]), tmp_path / "ring")) == ["err.png"]


def test_same_run_gives_the_same_bytes(plant_run, tmp_path):
    once, again = (_save(plot_route({"one": plant_run}), tmp_path / name) for name in ("once.png", "again.png"))
    assert once.read_bytes() == again.read_bytes()


def test_several_runs_are_compared(plant_folder, ring_run, plant_run, tmp_path):
    second = tmp_path / "second"
    second.mkdir()
    plant_run.assign_attrs(seed=2).to_netcdf(second / "run.nc")
    assert names(draw_runs([plant_folder, second / "run.nc"], tmp_path / "both")) == ["err.png", "route.png"]
    assert names(compare({"plant": plant_run, "ring": ring_run}, tmp_path / "mixed")) == ["err.png"]


@pytest.mark.parametrize(
    ("attributes", "overrides", "expected"),
    [
        ([{"name": "a"}, {"name": "b"}], None, ["a", "b"]),
        ([{"seed": 1}, {"seed": 2}], None, ["plant, seed 1", "plant, seed 2"]),
        ([{}, {}], ["policy.theta=0.0", "policy.theta=0.2"], ["policy.theta=0.0", "policy.theta=0.2"]),
    ],
)
def test_runs_are_called_by_what_tells_them_apart(plant_run, tmp_path, monkeypatch, attributes, overrides, expected):
    from dafw.views import files

    seen = {}
    monkeypatch.setattr(files, "compare", lambda runs, folder: seen.update(runs) or [])
    for index, own in enumerate(attributes):
        folder = tmp_path / str(index)
        (folder / ".hydra").mkdir(parents=True)
        plant_run.isel(time=slice(0, 2)).assign_attrs(own).to_netcdf(folder / "run.nc")
        if overrides:
            (folder / ".hydra" / "overrides.yaml").write_text(f"- experiment=paper\n- {overrides[index]}\n")
    draw_runs([tmp_path / "0", tmp_path / "1"], tmp_path / "out")
    assert list(seen) == expected


def test_the_same_run_twice_is_refused(plant_folder):
    with pytest.raises(RunError, match="the same one twice"):
        draw_runs([plant_folder, plant_folder / "run.nc"], None)


def test_whole_ensembles_of_fields_are_not_read(plant_folder, plant_run, tmp_path):
    from dafw.views.files import _load

    ensemble = np.zeros((plant_run.sizes["time"], plant_run.sizes["member"], plant_run.sizes["node"]))
    plant_run.assign(concentration_members=(("time", "member", "node"), ensemble)).to_netcdf(tmp_path / "all.nc")
    loaded = _load(tmp_path / "all.nc")
    assert "concentration_members" not in loaded and "wind_speed_members" in loaded


def test_paths_without_a_run_are_named(tmp_path, plant_folder):
    import xarray as xr

    with pytest.raises(RunError, match=r"nowhere: holds no run"):
        draw_runs([tmp_path / "nowhere"], None)
    with pytest.raises(RunError, match=r"run\.nc: holds no run"):
        draw_runs([tmp_path], None)
    with pytest.raises(RunError, match="at least one"):
        draw_runs([], None)
    (tmp_path / "text.nc").write_text("not a netCDF file")
    with pytest.raises(RunError, match=r"text\.nc: cannot be read") as caught:
        draw_runs([tmp_path / "text.nc"], None)
    assert "\n" not in str(caught.value)
    xr.Dataset({"depth": ("x", [1.0])}).to_netcdf(tmp_path / "ocean.nc")
    with pytest.raises(RunError, match=r"ocean\.nc: not a run of dafw"):
        draw_runs([tmp_path / "ocean.nc"], None)
    cut = tmp_path / "cut.nc"
    whole = (plant_folder / "run.nc").read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RunError, match=r"cut\.nc"):
        draw_runs([cut], None)


def test_a_run_without_its_scores_is_refused_by_name(plant_run, tmp_path):
    plant_run.drop_vars("err_free").to_netcdf(tmp_path / "run.nc")
    with pytest.raises(RunError, match="needs err_free"):
        draw_runs([tmp_path], None)


def test_an_interrupted_save_keeps_the_former_picture(tmp_path, monkeypatch):
    file = _save(Figure(), tmp_path / "err.png")
    before = file.read_bytes()

    def fail(self, stream, **_):
        stream.write(b"half a picture")
        raise KeyboardInterrupt

    monkeypatch.setattr(Figure, "savefig", fail)
    with pytest.raises(KeyboardInterrupt):
        _save(Figure(), file)
    assert file.read_bytes() == before
    assert list(tmp_path.iterdir()) == [file]


def test_no_interactive_matplotlib_is_loaded():
    code = "import sys, dafw.views; sys.exit('matplotlib.pyplot' in sys.modules or 'xarray' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
