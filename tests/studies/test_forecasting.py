"""Forecasts of runs: their files, and that the run itself does not change."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import geopandas
import netCDF4
import numpy as np
import pytest
import xarray
from conventions import breaches
from run_files import contents

import dafw
from dafw import ConfigurationError, ForecastPlan, RunError, SolverError, Study
from dafw.commands import main
from dafw.core.forecasts.forecast_file import ForecastFile
from dafw.core.geography import to_degrees
from dafw.core.options import describe
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.models.dispersion.model import AdvectionDiffusion
from dafw.plugins.models.linear_advection import LinearAdvection
from dafw.plugins.observers.drone import Drone
from dafw.plugins.observers.grid import Grid
from dafw.plugins.readings.listed import Listed
from dafw.studies.forecast_scores import KEPT, kept_scores
from dafw.studies.forecasting import NO_PLACE, Forecasting
from dafw.studies.running import run_study

GATE = [[150.0, 0.0], [200.0, 0.0], [200.0, 80.0], [150.0, 80.0]]
PLAN = ForecastPlan(every=2.0, horizon=20.0, lead_times=[0.0, 10.0, 20.0], thresholds=[0.1, 0.02], areas={"gate": GATE})
OPTIONS = {
    "mesh": {"wall_size": 40.0, "far_size": 60.0},
    "release": [250.0, 40.0],
    "wind_direction": 3.1,
    "wind_direction_sd": 0.3,
}


def gas(**changes):
    options = {**OPTIONS, "wind_speed": 4.0, "wind_speed_sd": 2.0, "noise": 0.1, **changes}
    return AdvectionDiffusion.from_options(**options)


def study(**changes):
    """Return a study of six cycles on a coarse mesh."""
    sure = {"wind_speed_sd": 0.0, "wind_direction_sd": 0.0, "noise": 0.0}
    parts = {
        "model": gas(),
        "truth": gas(wind_speed=5.0, **sure),
        "free": gas(**sure),
        "observer": Drone(),
        "filter": ETKF(),
        "start": [[250.0, 0.0]],
        "members": 4,
        "cycles": 6,
        "forecast": PLAN,
    }
    return Study(**(parts | changes))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder of a run with forecasts at 2, 4 and 6 s."""
    place = tmp_path_factory.mktemp("runs") / "with"
    run_study(study(), place)
    return place


def file_bits(path):
    with netCDF4.Dataset(path) as file:
        file.set_auto_mask(False)
        return {name: np.asarray(variable[...]).astype(str).tobytes() for name, variable in file.variables.items()}


def test_forecasts_and_their_scores_keep_to_the_conventions(folder):
    kept_scores(folder)
    assert [breaches(folder / name) for name in ("run.nc", "forecast.nc", KEPT)] == [[], [], []]


def test_a_run_has_the_same_bits_with_and_without_forecasts(folder, tmp_path):
    run_study(study(forecast=ForecastPlan()), tmp_path / "without")
    assert contents(folder) == contents(tmp_path / "without")
    assert not (tmp_path / "without" / "forecast.nc").exists()
    summary = json.loads((tmp_path / "without" / "summary.json").read_text())
    assert summary["forecasts"] is None


def test_the_same_seed_gives_the_same_forecasts(folder, tmp_path):
    run_study(study(), tmp_path / "again")
    assert file_bits(folder / "forecast.nc") == file_bits(tmp_path / "again" / "forecast.nc")
    for path in (folder / "forecasts").iterdir():
        assert path.read_bytes() == (tmp_path / "again" / "forecasts" / path.name).read_bytes()


def test_the_file_opens_with_plain_xarray_and_says_what_it_holds(folder):
    with xarray.open_dataset(folder / "forecast.nc") as file:
        assert file["issue"].values.tolist() == [2.0, 4.0, 6.0]
        assert file["lead"].values.tolist() == [0.0, 10.0, 20.0]
        assert file["threshold"].values.tolist() == [0.02, 0.1]
        assert file["valid_time"].values[1].tolist() == [4.0, 14.0, 24.0]
        assert file["exceedance_probability"].dims == ("issue", "lead", "threshold", "node")
        assert file["exceedance_probability"].attrs["mesh"] == "mesh2d"
        assert file["mesh2d"].attrs["cf_role"] == "mesh_topology"
        assert file["lead"].attrs["standard_name"] == "forecast_period"
        assert file["area_name"].values.tolist() == ["gate"]
        assert "Flare" in file["building_name"].values
        chances = file["exceedance_probability"].values
        assert ((chances >= 0.0) & (chances <= 1.0)).all() and np.isin(chances, np.arange(5) / 4).all()
        # A lower threshold is exceeded more often, arrives no later and clears no earlier.
        assert (chances[:, :, 0] >= chances[:, :, 1]).all()
        arrival, clearing = (file[f"{name}_time"].fillna(1e9).values for name in ("arrival", "clearing"))
        assert (arrival[:, 0] <= arrival[:, 1]).all() and (clearing[:, 0] >= clearing[:, 1]).all()
        assert (np.diff(arrival, axis=2) >= 0.0).all() and (np.diff(clearing, axis=2) >= 0.0).all()
        # What is exceeded at some lead time is reached within the horizon.
        assert (file["reach_probability"].values >= chances.max(axis=1)).all()


def test_lead_time_zero_is_the_belief_of_the_run(folder):
    with dafw.open_run(folder) as run, dafw.open_forecasts(folder) as file:
        rows = np.searchsorted(run["time"].values, file["issue"].values)
        truth = run["concentration_truth"].values[rows]
        np.testing.assert_array_equal(file["concentration_truth"].values[:, 0], truth)
        np.testing.assert_array_equal(file["concentration_free"].values[:, 0], run["concentration_free"].values[rows])


def test_the_truth_ahead_is_that_of_a_longer_run(folder, tmp_path):
    run_study(study(cycles=26, forecast=ForecastPlan()), tmp_path / "longer")
    with dafw.open_run(tmp_path / "longer") as run, dafw.open_forecasts(folder) as file:
        for issue in range(3):
            rows = np.searchsorted(run["time"].values, file["valid_time"].values[issue])
            ahead = file["concentration_truth"].values[issue]
            np.testing.assert_array_equal(ahead, run["concentration_truth"].values[rows])


def test_polygons_open_in_another_program_where_the_gas_is(folder):
    names = sorted(path.name for path in (folder / "forecasts").iterdir())
    assert names == ["issued_2s.geojson", "issued_4s.geojson", "issued_6s.geojson"]
    shapes = geopandas.read_file(folder / "forecasts" / "issued_4s.geojson")
    assert shapes.is_valid.all() and shapes.crs.to_epsg() == 4326
    maps = shapes[shapes["kind"] == "exceedance"]
    assert set(maps["lead"]) == {0.0, 10.0, 20.0} and set(maps["probability"]) == {0.1, 0.5, 0.9}
    with dafw.open_forecasts(folder) as file:
        origin = [file.attrs[f"origin_{name}"] for name in ("longitude", "latitude")]
        chances = file["exceedance_probability"].sel(issue=4.0, lead=10.0, threshold=0.02).values
        reached = float(file["area_reach_probability"].sel(issue=4.0, threshold=0.02)[0])
        places = geopandas.points_from_xy(
            *to_degrees(np.column_stack([file["node_x"].values, file["node_y"].values]), origin).T
        )
    one = maps[(maps["lead"] == 10.0) & (maps["threshold"] == 0.02) & (maps["probability"] == 0.5)].geometry.union_all()
    # Not at walls and edges, where rounding to a millimetre decides.
    sure = places.distance(one.boundary) > 1e-6
    np.testing.assert_array_equal(places.within(one)[sure], (chances >= 0.5)[sure])
    areas = shapes[(shapes["kind"] == "area") & (shapes["threshold"] == 0.02)]
    assert areas["name"].tolist() == ["gate"] and areas["probability"].tolist() == [reached]


def test_late_in_a_long_run_every_forecast_has_its_own_polygons(tmp_path):
    parts, state = study().begin()
    forecasting = Forecasting(PLAN, parts, state, tmp_path, {})
    for time in (999_998.0, 1_000_002.0, 1_000_004.5):
        belief = replace(state.belief, ensemble=replace(state.belief.ensemble, time=time))
        assert forecasting.issue(replace(state, belief=belief)) is None
    forecasting.close()
    names = sorted(path.name for path in (tmp_path / "forecasts").iterdir())
    assert names == ["issued_1000002s.geojson", "issued_1000004.5s.geojson", "issued_999998s.geojson"]


def test_the_summary_counts_forecasts(folder):
    told = json.loads((folder / "summary.json").read_text())["forecasts"]
    assert (told["issued"], told["failed"]) == (3, 0) and told["seconds"] > 0.0
    assert "probability of more than 0.02: gate" in (folder / "run.log").read_text()


def test_a_configuration_makes_the_same_study_as_objects(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    sure = "wind_speed_sd: 0.0, wind_direction_sd: 0.0, noise: 0.0"
    (tmp_path / "experiment").mkdir()
    (tmp_path / "experiment" / "small.yaml").write_text(
        f"""# @package _global_
defaults: [override /model: ad, override /observer: drone, override /policy: stationary, override /filter: etkf, _self_]
name: small
members: 4
cycles: 6
pictures: true
model: {{{json.dumps(OPTIONS)[1:-1]}, wind_speed: 4.0, wind_speed_sd: 2.0, noise: 0.1}}
truth: {{wind_speed: 5.0, {sure}}}
free: {{{sure}}}
vehicle: {{start: [[250.0, 0.0]]}}
forecast:
  every: 2.0
  horizon: 20.0
  lead_times: [0.0, 10.0, 20.0]
  thresholds: [0.1, 0.02]
  areas: {{gate: {GATE}}}
"""
    )
    assert main(["run", "--config-dir", ".", "experiment=small", "hydra.run.dir=out"]) == 0
    assert contents(folder) == contents(tmp_path / "out")
    assert file_bits(folder / "forecast.nc") == file_bits(tmp_path / "out" / "forecast.nc")
    assert (tmp_path / "out" / "figures" / "forecast.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["forecast.every=1.5"], "must be a whole number of time steps"),
        (["forecast.every=1", "forecast.thresholds=[]"], "needs one number or more"),
        (["forecast.every=1", "+forecast.areas.gate=[[0,0],[1,0],[1,1]]"], "areas need a model with a mesh"),
        (["forecast.evry=1"], "did you mean 'every'"),
    ],
)
def test_a_wrong_plan_is_one_line_before_anything_is_computed(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "experiment=linear_advection", *words]) == 2
    said = capsys.readouterr().err.strip()
    assert message in said and "\n" not in said
    assert not (tmp_path / "outputs").exists()


def test_a_study_made_in_python_is_checked_too():
    with pytest.raises(ConfigurationError, match="forecast must be a ForecastPlan, got dict"):
        study(forecast={"every": 1.0})
    with pytest.raises(ConfigurationError, match="study, forecast: option 'every' must be above 0"):
        study(forecast=ForecastPlan(every=-1.0))
    with pytest.raises(ConfigurationError, match="area 'sea' holds no place"):
        study(forecast=ForecastPlan(every=2.0, areas={"sea": [[900, 0], [999, 0], [999, 9]]})).prepare()


def test_a_model_without_a_mesh_has_forecasts_at_its_nodes(tmp_path):
    line = LinearAdvection(cells=20, length=20.0, dt=1.0)
    plan = ForecastPlan(every=5.0, horizon=4.0, lead_times=[4.0], thresholds=[0.5])
    parts = {"truth": LinearAdvection(cells=20, length=20.0, dt=1.0), "observer": Grid(stride=5)}
    run_study(Study(model=line, filter=ETKF(), cycles=10, forecast=plan, **parts), tmp_path / "line")
    with dafw.open_forecasts(tmp_path / "line") as file:
        assert file.sizes["issue"] == 2 and file.sizes["node"] == 20 and "area" not in file.dims
    assert not (tmp_path / "line" / "forecasts").exists()
    scores = dafw.forecast_scores(tmp_path / "line")
    assert np.isfinite(scores["brier_belief"]).all() and np.isnan(scores["contour_distance_belief"]).all()


def test_without_a_truth_nothing_is_verified(tmp_path):
    lonely = study(truth=None, readings=Listed([{"time": 1.0, "x": 250.0, "y": 0.0, "value": 0.1}], sd=0.1))
    run_study(lonely, tmp_path / "lonely")
    with dafw.open_forecasts(tmp_path / "lonely") as file:
        assert file.sizes["issue"] == 3 and not [name for name in file if str(name).endswith(("_truth", "_free"))]
    with pytest.raises(RunError, match="there is no truth to judge the forecasts by"):
        dafw.forecast_scores(tmp_path / "lonely")


def test_a_plane_without_a_place_on_earth_has_no_polygons_and_says_so(tmp_path):
    model = gas()
    model.__dict__["domain"] = replace(model.domain, origin=None)  # a cached property
    run_study(study(model=model), tmp_path / "nowhere")
    assert not (tmp_path / "nowhere" / "forecasts").exists()
    assert NO_PLACE in (tmp_path / "nowhere" / "run.log").read_text()
    with dafw.open_forecasts(tmp_path / "nowhere") as file:
        assert file.sizes["issue"] == 3


def test_a_model_that_cannot_run_ahead_costs_the_forecast_and_not_the_run(tmp_path, monkeypatch, capsys):
    from dafw.studies import forecasting

    def fails(*arguments):
        raise SolverError("no convergence")

    monkeypatch.setattr(forecasting, "run_ahead", fails)
    summary = run_study(study(), tmp_path / "failing")
    assert summary["status"] == "complete" and summary["forecasts"]["failed"] == 3
    assert capsys.readouterr().err.count("no forecast is made, the model cannot run ahead: no convergence") == 1
    with dafw.open_forecasts(tmp_path / "failing") as file:
        assert file.sizes["issue"] == 0


def test_a_run_that_is_cut_off_while_it_writes_leaves_whole_forecasts_only(folder, tmp_path, monkeypatch):
    """A row is complete when its ``issue`` is there: the last number that is written."""
    cut = tmp_path / "cut.nc"
    shutil.copy(folder / "forecast.nc", cut)
    with netCDF4.Dataset(cut, "a") as file:
        file.variables["exceedance_probability"][3] = 0.5
    with dafw.open_forecasts(cut) as file:
        assert file["issue"].values.tolist() == [2.0, 4.0, 6.0]
    written = []
    whole = ForecastFile.write

    def interrupted(self, belief, singles):
        written.append(belief.time)
        if len(written) == 2:
            raise KeyboardInterrupt
        whole(self, belief, singles)

    monkeypatch.setattr(ForecastFile, "write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_study(study(), tmp_path / "stopped")
    with dafw.open_forecasts(tmp_path / "stopped") as file, dafw.open_run(tmp_path / "stopped") as run:
        assert file["issue"].values.tolist() == [2.0] and run["time"].values[-1] == 4.0
    assert [path.name for path in (tmp_path / "stopped" / "forecasts").iterdir()] == ["issued_2s.geojson"]


def test_what_holds_no_forecasts_is_refused(tmp_path):
    with pytest.raises(RunError, match="holds no forecasts"):
        dafw.open_forecasts(tmp_path)
    (tmp_path / "forecast.nc").write_text("no netCDF")
    with pytest.raises(RunError, match="cannot be read as netCDF"):
        dafw.open_forecasts(tmp_path)


def test_damaged_forecasts_are_refused_or_open(folder, tmp_path):
    whole = (folder / "forecast.nc").read_bytes()
    refused = 0
    for place in range(0, len(whole) - 64, len(whole) // 150):
        damaged = tmp_path / f"damaged{place}.nc"
        damaged.write_bytes(whole[:place] + b"Z" * 64 + whole[place + 64 :])
        try:
            dafw.open_forecasts(damaged).close()
        except RunError as error:
            assert str(damaged) in str(error)
            refused += 1
    assert refused > 5


PAGE = (Path(__file__).resolve().parents[2] / "docs" / "forecasts.md").read_text(encoding="utf-8")
SITE = ("node_", "mesh2d", "obstacle", "landmark")
"""How the names of mesh and site begin; docs/run-file.md has them."""


def names_on_the_page(begin, end):
    table = PAGE.split(begin)[1].split(end)[0]
    cells = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    return {name for cell in cells for name in re.findall("`([^`]+)`", cell)}


def test_the_page_has_every_name_of_the_file(folder):
    on_page = names_on_the_page("## What a run leaves", "A time is missing")
    with dafw.open_forecasts(folder) as file:
        found = {str(name) for name in file.variables if not str(name).startswith(SITE)}
    own = {re.sub("^(area|building)_(?!name|arrival_time_members)|_(truth|free|released)$", "", name) for name in found}
    own = {re.sub("_(truth|free|released)$", "", name).replace("concentration_", "<variable>_") for name in own}
    shorthand = {name for name in on_page if "..." in name}
    assert shorthand == {"area_...", "building_...", "..._truth", "..._free", "..._released"}
    assert own - {"concentration"} == on_page - shorthand


def test_the_page_has_every_option_with_its_default():
    section = PAGE.split("## Options")[1].split("\n## ")[0]
    rows = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("| `")]
    said = {cells[0].strip(" `"): cells[1].strip() for cells in rows}
    defaults = {f"forecast.{one.name}": one.default for one in describe(ForecastPlan)}
    assert set(said) == set(defaults)
    for name, default in defaults.items():
        if isinstance(default, list):
            told = {", ".join(f"{number:g}" for number in default)}
        elif default is None or default == {}:
            told = {"none", "null"}
        else:
            told = {str(default).lower().removesuffix(".0")}
        assert said[name] in told, name
