"""Picture files: which ones a run gets, that they are complete, and the error if there is no run."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, field

import numpy as np
import pytest
import xarray
from absent import without_truth
from matplotlib.figure import Figure
from matplotlib.image import imread

import dafw
from dafw import Model, StateSpace, Study, Variable
from dafw.core.errors import RunError
from dafw.plugins.filters.enks import EnKS
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.readings.listed import Listed
from dafw.views import compare, draw_all, draw_runs, plot_route
from dafw.views.files import save
from dafw.views.printing import Paper


def names(files):
    return [file.name for file in files]


def test_a_plant_gets_all_pictures_of_the_paper(plant_folder):
    files = draw_runs([plant_folder], None)
    assert names(files) == [
        "err.png",
        "innovations.png",
        "route.png",
        "contours.png",
        "section.png",
        "parameters.png",
    ]
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
    once, again = (save(plot_route({"one": plant_run}), tmp_path / name) for name in ("once.png", "again.png"))
    assert once.read_bytes() == again.read_bytes()


def test_several_runs_are_compared(plant_folder, ring_run, plant_run, tmp_path):
    second = tmp_path / "second"
    second.mkdir()
    plant_run.assign_attrs(seed=2).to_netcdf(second / "run.nc")
    both = draw_runs([plant_folder, second / "run.nc"], tmp_path / "both")
    assert names(both) == ["err.png", "innovations.png", "route.png"]
    assert names(compare({"plant": plant_run, "ring": ring_run}, tmp_path / "mixed")) == ["err.png", "innovations.png"]


def test_what_cannot_be_compared_is_said_in_a_line_each(plant_run, untold_run, ring_run, tmp_path, capsys):
    files = compare({"scored": plant_run, "untold": untold_run}, tmp_path / "one")
    assert names(files) == ["err.png", "innovations.png", "route.png"]
    assert capsys.readouterr().err == "dafw: untold: no truth, so not in err.png\n"
    files = compare({"untold": untold_run, "ring": ring_run}, tmp_path / "two")
    assert names(files) == ["err.png", "innovations.png"]
    assert capsys.readouterr().err.splitlines() == [
        "dafw: untold: no truth, so not in err.png",
        "dafw: ring: no readings, so not in innovations.png",
        "dafw: ring: no map, so no route.png",
    ]
    files = compare({"a": untold_run, "b": untold_run}, tmp_path / "three")
    assert names(files) == ["innovations.png", "route.png"] and capsys.readouterr().err == ""
    with pytest.raises(RunError, match="nothing that can be compared: no truth, no readings, no map"):
        compare({"a": without_truth(ring_run), "b": without_truth(ring_run)}, tmp_path / "four")


def test_a_run_without_a_truth_gets_innovations_instead_of_errors(untold_run, ring_run, tmp_path):
    assert names(draw_all(untold_run, tmp_path / "plant")) == [
        "innovations.png",
        "route.png",
        "contours.png",
        "section.png",
        "parameters.png",
    ]
    assert names(draw_all(without_truth(ring_run), tmp_path / "ring")) == ["state.png"]


@dataclass
class Pond(Model):
    """A level and an unknown leak; the level is read in some cycles."""

    space: StateSpace = field(default_factory=lambda: StateSpace([Variable("level", 1), Variable("leak", 1)]))
    dt: float = 10.0
    leak: float = 0.01

    def initial(self, n_members, rng):
        return np.column_stack([2.0 + rng.standard_normal((n_members, 1)), np.full(n_members, self.leak)])

    def step(self, members, t, rng):
        return members * [1.0 - self.dt * self.leak, 1.0]


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ({}, ["innovations.png", "parameters.png"]),
        ({"free": Pond()}, ["innovations.png", "parameters.png"]),
        ({"truth": Pond(leak=0.02)}, ["err.png", "innovations.png", "parameters.png"]),
        ({"truth": Pond(), "free": Pond(), "filter": EnKS()}, ["err.png", "innovations.png", "parameters.png"]),
        ({"readings": Listed()}, ["parameters.png"]),
    ],
)
def test_what_a_study_of_any_kind_records_can_be_drawn(more, expected, tmp_path):
    readings = Listed([{"time": 10.0 * k, "value": 2.0, "entry": 0} for k in range(1, 4)])
    parts = {"model": Pond(), "filter": ETKF(), "readings": readings, "members": 4, "cycles": 5} | more
    run = dafw.run(Study(**parts, pictures=True), tmp_path / "pond")
    run.close()
    assert sorted(names((tmp_path / "pond" / "figures").iterdir())) == expected


@pytest.mark.parametrize(
    ("attributes", "overrides", "expected"),
    [
        ([{"name": "a"}, {"name": "b"}], None, ["a", "b"]),
        ([{"seed": 1}, {"seed": 2}], None, ["plant, seed 1", "plant, seed 2"]),
        ([{}, {}], ["policy.theta=0.0", "policy.theta=0.2"], ["policy.theta=0.0", "policy.theta=0.2"]),
        (
            [{}, {}],
            ["readings.readings=[{time: 0.5, value: 1.0, entry: 0}]", "seed=1"],
            ["readings.readings=[{time: 0.5, value:...", "seed=1"],
        ),
    ],
)
def test_runs_are_called_by_what_tells_them_apart(plant_run, tmp_path, monkeypatch, attributes, overrides, expected):
    from dafw.views import files

    seen = {}
    monkeypatch.setattr(files, "compare", lambda runs, folder, paper: seen.update(runs) or [])
    for index, own in enumerate(attributes):
        folder = tmp_path / str(index)
        (folder / ".hydra").mkdir(parents=True)
        plant_run.isel(time=slice(0, 2)).assign_attrs(own).to_netcdf(folder / "run.nc")
        if overrides:
            (folder / ".hydra" / "overrides.yaml").write_text(f"- experiment=paper\n- '{overrides[index]}'\n")
    draw_runs([tmp_path / "0", tmp_path / "1"], tmp_path / "out")
    assert list(seen) == expected


def test_the_same_run_twice_is_refused(plant_folder):
    with pytest.raises(RunError, match="the same one twice"):
        draw_runs([plant_folder, plant_folder / "run.nc"], None)


def test_whole_ensembles_of_fields_are_not_read(plant_folder, plant_run, tmp_path):
    from dafw.views.files import load_run

    ensemble = np.zeros((plant_run.sizes["time"], plant_run.sizes["member"], plant_run.sizes["node"]))
    plant_run.assign(concentration_members=(("time", "member", "node"), ensemble)).to_netcdf(tmp_path / "all.nc")
    loaded = load_run(tmp_path / "all.nc")
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


def test_a_run_without_its_belief_is_refused_by_name(plant_run, tmp_path):
    plant_run.drop_vars("concentration_mean").to_netcdf(tmp_path / "run.nc")
    with pytest.raises(RunError, match="needs concentration_mean"):
        draw_runs([tmp_path], None)


def test_an_interrupted_save_keeps_the_former_picture(tmp_path, monkeypatch):
    file = save(Figure(), tmp_path / "err.png")
    before = file.read_bytes()

    def fail(self, figure, stream):
        stream.write(b"half a picture")
        raise KeyboardInterrupt

    monkeypatch.setattr(Paper, "write", fail)
    with pytest.raises(KeyboardInterrupt):
        save(Figure(), file)
    assert file.read_bytes() == before
    assert list(tmp_path.iterdir()) == [file]


def test_no_interactive_matplotlib_is_loaded():
    code = "import sys, dafw.views; sys.exit('matplotlib.pyplot' in sys.modules or 'xarray' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


PLOT = "from dafw.views import draw_runs; draw_runs([folder], folder)"
END = "from dafw.studies.pictures import draw_pictures; draw_pictures(folder)"


@pytest.mark.parametrize("draw", [PLOT, END], ids=["dafw plot", "the end of a run"])
def test_drawing_a_run_loads_neither_dask_nor_pint(plant_folder, draw):
    # With them the pictures of a run would take a third longer.
    code = (
        f"import pathlib, sys; folder = pathlib.Path({str(plant_folder)!r})\n{draw}\n"
        "sys.exit(bool({'dask.array', 'pint'} & sys.modules.keys()))"
    )
    for picture in plant_folder.rglob("*.png"):
        picture.unlink()
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    assert {"err.png", "contours.png", "route.png"} <= {picture.name for picture in plant_folder.rglob("*.png")}


def test_a_run_is_opened_as_xarray_opens_it(plant_folder):
    file = plant_folder / "run.nc"
    with dafw.open_run(file) as ours, xarray.open_dataset(file, decode_times=False) as theirs:
        xarray.testing.assert_identical(ours, theirs)
        assert [*ours.variables] == [*theirs.variables]
        assert ours["obstacle_name"].dtype == theirs["obstacle_name"].dtype
    with dafw.open_run(file, indexed=False) as ours:
        assert not ours.indexes
        assert ours["time"].size > 0
