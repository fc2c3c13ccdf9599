"""An unmodified foreign site: site, mesh, wind and ten cycles among the footprints of West Oakland."""

from pathlib import Path

import pytest

import dafw

FOOTPRINTS = Path(__file__).parents[2] / "shared" / "data" / "west_oakland_buildings.geojson"

BASIS = [f"model.wind.basis.{word}" for word in ("directions=8", "levels=1", "modes=16", "tolerance=1")]
"""A coarse one, which is made in some seconds."""


@pytest.mark.skipif(not FOOTPRINTS.is_file(), reason="the footprints are not part of the project (../shared/data)")
def test_ten_cycles_among_foreign_buildings(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = dafw.run(
        [
            f"model.site.file={FOOTPRINTS}",
            "model.release=[150,150]",
            "vehicle.start=[[0,250]]",
            "section=[[150,150],[-100,150]]",
            "members=4",
            "cycles=10",
            *BASIS,
        ]
    )
    with run:
        assert run.sizes["time"] == 11 and run.sizes["obstacle"] == 17
        # solved once for each member at the start, and the gas has moved with the wind, not stood still
        assert run["model_wind_solved"][1].values.all()
        assert run["err"].notnull().all() and 0.0 < run["err"][-1] < 150.0
        assert float(run["concentration_truth"][-1].max()) <= 1.0
        log = (Path(run.attrs["folder"]) / "run.log").read_text()
    assert "23 footprints found" in log and "17 buildings kept" in log
    assert {p.name for p in (Path(run.attrs["folder"]) / "figures").iterdir()} >= {"route.png", "contours.png"}
