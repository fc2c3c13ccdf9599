"""Files of runs, as others read them: the checkers of CF and of UGRID, and uxarray.

Each is asked in an environment of its own: a study has no use for what the checkers need, and uxarray with what
it draws with takes a gigabyte and minutes to install.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Mapping
from contextlib import chdir, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np

from benchmarks import Measurement, benchmark
from benchmarks.environments import worker_output
from dafw.core.errors import ComputationError

CHECKERS = ("compliance-checker==6.1.0", "cc-plugin-ugrid==1.1.0")
UXARRAY = ("uxarray==2026.10.0", "cartopy", "matplotlib==3.10.*")
STUDY_FILES = ("run.nc", "forecast.nc", "study.nc", "moving.nc", "fixed.nc")
FACES = "nfaces"
"""What the UGRID plugin wants the dimension of the faces to be called."""

EXPECTED = (
    "cf_role",
    "variable 'obstacle_",
    "'time' should have standard_name='time'",
    "is not a timeseries, it is detected as a point",
    "check_coordinate_variables_strict_monotonicity",
    "check_domain_variables",
)
"""Of complaints that are left (docs/run-file.md, "Conventions")."""


def _run_with_forecasts(folder: Path) -> None:
    """Make a run among buildings on a coarse mesh, of a few seconds, with all members and one forecast."""
    import dafw
    from dafw.plugins.filters.etkf import ETKF
    from dafw.plugins.models.dispersion.model import AdvectionDiffusion
    from dafw.plugins.observers.drone import Drone

    def gas(**options: Any) -> AdvectionDiffusion:
        mesh = {"wall_size": 60.0, "far_size": 90.0}
        return AdvectionDiffusion.from_options(mesh=mesh, release=[250.0, 40.0], wind_direction=3.1, **options)

    yard = [[150, 0], [200, 0], [200, 80], [150, 80]]
    plan = dafw.ForecastPlan(
        every=3.0, horizon=4.0, lead_times=[0.0, 4.0], thresholds=[0.02, 0.1], areas={"yard": yard}
    )
    study = dafw.Study(
        model=gas(wind_speed=4.0, wind_speed_sd=2.0),
        truth=gas(wind_speed=5.0),
        free=gas(wind_speed=4.0),
        observer=Drone(),
        filter=ETKF(),
        start=[[250.0, 0.0]],
        members=4,
        cycles=4,
        record="all",
        seed=1000,
        forecast=plan,
    )
    dafw.run(study, folder)


def files(folder: Path) -> list[Path]:
    """Make a run, a study and files of readings in an empty folder; return their netCDF files."""
    from dafw.commands import main

    _run_with_forecasts(folder / "run")
    fixed = [f"2026-05-01T00:00:{t:02},{one},{x},2,0.{t}" for t in range(1, 4) for one, x in (("a", 1), ("b", 3))]
    (folder / "fixed.csv").write_text("\n".join(["time,sensor,x,y,value", *fixed]) + "\n", encoding="utf-8")
    requests = (
        ["study", "tiny", "cycles=5", "--seeds", "1000-1001", "--no-pictures", "--workers", "1", "--folder", "study"],
        ["readings", "run", "--to", "moving.nc"],
        ["readings", "fixed.csv", "unit=ppm", "--to", "fixed.nc"],
    )
    with chdir(folder), redirect_stdout(StringIO()):
        for words in requests:
            if main(words):
                raise ComputationError(f"dafw {' '.join(words)} failed")
    found = [next(folder.rglob(name)) for name in STUDY_FILES]
    return [Path(shutil.copyfile(path, folder / path.name)) if path.parent != folder else path for path in found]


def complaints(path: Path) -> dict[str, list[str]]:
    """Return what the checkers say of a file: those complaints that are ``left`` on purpose, and the ``others``."""
    with netCDF4.Dataset(path, "a") as file:
        names = file.ncattrs()
        meshed = "mesh2d" in file.variables
        if meshed:
            file.renameDimension("face", FACES)
    if "Conventions" not in names:
        return {"left": [], "others": ["no attribute Conventions"]}
    suites = ["cf:1.11", *(["UGRID:2.0"] if meshed else [])]
    said: list[str] = json.loads(worker_output(CHECKERS, "check_netcdf.py", [str(path), *suites]))
    left = [line for line in said if any(words in line for words in EXPECTED)]
    return {"left": left, "others": [line for line in said if line not in left]}


@benchmark("netcdf.complaints")
def netcdf_complaints(short: bool) -> Measurement:
    """Complaints of the CF and UGRID checkers about all netCDF files, without those that are explained."""
    with tempfile.TemporaryDirectory() as folder:
        made = files(Path(folder))
        told: Mapping[str, Any] = {path.name: complaints(path) for path in (made[-1:] if short else made)}
    return Measurement(sum(len(one["others"]) for one in told.values()), "complaints", 0, told)


@benchmark("netcdf.uxarray")
def netcdf_uxarray(short: bool) -> Measurement:
    """Share of the fields of run.nc and forecast.nc that uxarray opens, with the same numbers, and draws."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder, "run")
        _run_with_forecasts(run)
        told = {}
        for name in ("run.nc",) if short else ("run.nc", "forecast.nc"):
            with netCDF4.Dataset(run / name) as file:
                file.set_auto_mask(False)
                ours = {key: one for key, one in file.variables.items() if getattr(one, "mesh", "") == "mesh2d"}
                sums = {key: float(np.nansum(one[...], dtype=np.float64)) for key, one in ours.items()}
            drawn = json.loads(worker_output(UXARRAY, "draw_with_uxarray.py", [str(run / name)]))
            same = [key for key, total in sums.items() if np.isclose(drawn.get(key, np.nan), total, rtol=1e-9)]
            told[name] = {"fields": len(sums), "drawn": len(same), "not_drawn": sorted({*sums} - {*same})}
    share = sum(one["drawn"] for one in told.values()) / sum(one["fields"] for one in told.values())
    return Measurement(share, "share of the fields", 1.0, told)
