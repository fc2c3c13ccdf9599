"""A run's Dataset with chosen numbers: a square with a building in its middle, and variables of every kind."""

import numpy as np
from matplotlib.tri import Triangulation
from xarray import Dataset

import dafw.core.accessor  # noqa: F401 - so that Datasets have ``dafw``
from dafw.core.run_layout import KIND_NOTES
from dafw.core.space import Kind

SIDE = np.linspace(0.0, 10.0, 21)
NODES = np.stack(np.meshgrid(SIDE, SIDE), axis=-1).reshape(-1, 2)
EVERY = Triangulation(*NODES.T).triangles.astype(np.int32)
BUILDING = (4.0, 6.0)
"""The building is from 4 to 6 m in both directions."""
IN_BUILDING = ((NODES[EVERY].mean(axis=1) > 4.0) & (NODES[EVERY].mean(axis=1) < 6.0)).all(axis=1)
TRIANGLES = EVERY[~IN_BUILDING]
X, Y = NODES.T
TIMES = np.array([0.0, 2.0, 4.0])
ORIGIN = {"origin_longitude": 8.0, "origin_latitude": 50.0}


def square(fields=None, *, triangles=TRIANGLES, members=None, weights=None, **attributes):
    """Return a Dataset; ``fields`` by the name in the file are (node,) or (time, node).

    ``members`` by name: (values (time, member) or (time, member, node), kind, truth).
    """
    run = Dataset(
        coords={
            "time": ("time", TIMES, {"units": "s"}),
            "node_x": ("node", X, {"units": "m"}),
            "node_y": ("node", Y, {"units": "m"}),
        },
        attrs={"scored_variable": "gas", **attributes},
    )
    run["mesh2d_face_nodes"] = (("face", "face_corner"), triangles)
    for name, values in (fields or {}).items():
        run[name] = (("time", "node"), np.broadcast_to(values, (len(TIMES), len(NODES))), {"units": "kg m-3"})
    for name, (values, kind, truth) in (members or {}).items():
        nodes = ["node"] if np.ndim(values) == 3 else []
        notes = {"comment": KIND_NOTES[kind], "units": "m"} if kind is not Kind.FIELD else {"units": "m"}
        run[f"{name}_members"] = (("time", "member", *nodes), values, notes)
        for stage in ("mean", "spread"):  # other than those of the members, so that one sees which are used
            run[f"{name}_{stage}"] = (("time", *nodes), np.full_like(values[:, 0], -7.0), notes)
        if truth is not None:
            run[f"{name}_truth"] = (("time", *nodes), truth, notes)
    if weights is not None:
        run["weight"] = (("time", "member"), weights)
    return run
