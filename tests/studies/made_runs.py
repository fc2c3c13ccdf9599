"""Folders of runs with chosen numbers, as if they had been computed."""

import json

import numpy as np
from xarray import Dataset

from dafw.studies.study_files import study_of

TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])
CORNERS = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])
"""A rectangle of two triangles, each of area 1."""


def made_study(**entries):
    return study_of("made", {"configurations": {"a": []}, "seeds": "1-4", **entries})


def make_run(folder, err, *, status="complete", free=None, dt=1.0, scalars=None, field=None, **summary):
    """Write a run with ERR over time; ``scalars``: (mean, spread, truth, attributes) at the end, by name.

    ``field`` holds the last belief and truth at the four corners.
    """
    folder.mkdir(parents=True)
    rows = len(err)
    run = Dataset(coords={"time": ("time", dt * np.arange(rows), {"units": "s"})}, attrs={"scored_variable": "gas"})
    run["err"] = ("time", np.asarray(err, dtype=float))
    if free is not None:
        run["err_free"] = ("time", np.full(rows, float(free)))
    for name, (mean, spread, truth, attributes) in (scalars or {}).items():
        for stage, value in (("mean", mean), ("spread", spread), ("truth", truth)):
            run[f"{name}_{stage}"] = ("time", np.full(rows, value), attributes)
    if field is not None:
        for stage, values in zip(("mean", "truth"), field, strict=True):
            run[f"gas_{stage}"] = (("time", "node"), np.full((rows, 4), np.nan))
            run[f"gas_{stage}"][-1] = values
        run["mesh2d_face_nodes"] = (("face", "face_corner"), TRIANGLES)
        run["node_x"], run["node_y"] = ("node", CORNERS[:, 0]), ("node", CORNERS[:, 1])
    run.to_netcdf(folder / "run.nc", engine="netcdf4")
    known = {"status": status, "parameters_final": {name: {} for name in scalars or {}}, "wall_seconds": 3.0}
    phases = {"set-up": 1.0, "forecast": 0.5, "analyse": 1.5}
    (folder / "summary.json").write_text(json.dumps({**known, "phase_seconds": phases, **summary}))
