"""A run as a zarr store: the same numbers, in chunks for maps or for series; complete or not there at all."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import xarray as xr

from dafw.core.accessor import zarr_store  # with ``Dataset.dafw``
from dafw.core.errors import RunError

TIMES, NODES, MEMBERS = 6, 50, 3


@pytest.fixture
def run(tmp_path):
    """A file like a run's, opened lazily as ``dafw.open_run`` does."""
    values = np.random.default_rng(0).random((TIMES, MEMBERS, NODES)).astype(np.float32)
    made = xr.Dataset(
        {
            "gas_members": (("time", "member", "node"), values, {"units": "1"}),
            "gas_mean": (("time", "node"), values.mean(axis=1)),
            "err": ("time", np.arange(TIMES, dtype=np.float64)),
            "node_x": ("node", np.arange(NODES, dtype=np.float64)),
            "mesh": ((), np.int32(0), {"cf_role": "mesh_topology"}),
            "never": (("time", "observation"), np.empty((TIMES, 0))),
        },
        {"time": ("time", np.arange(TIMES, dtype=np.float64), {"units": "s"})},
        {"name": "made", "seed": 7},
    )
    made.to_netcdf(tmp_path / "run.nc", encoding={"gas_members": {"chunksizes": (1, MEMBERS, NODES)}})
    with xr.open_dataset(tmp_path / "run.nc", decode_times=False) as opened:
        yield opened


@pytest.mark.parametrize(
    ("chunks", "expected"),
    [("maps", {"gas_members": (2, MEMBERS, NODES), "gas_mean": (6, NODES)}), ("series", {"gas_members": (6, 3, 16)})],
)
def test_the_numbers_are_the_same_and_the_chunks_suit(run, tmp_path, monkeypatch, chunks, expected):
    monkeypatch.setattr(zarr_store, "CHUNK_BYTES", 1200)
    path = run.dafw.to_zarr(str(tmp_path / "out" / "run.zarr"), chunks)
    with xr.open_zarr(path, decode_times=False) as again:
        xr.testing.assert_identical(again.load(), run.load())
        for name, size in expected.items():
            assert again[name].encoding["chunks"] == size
    assert [one.name for one in path.parent.iterdir()] == ["run.zarr"]


def test_a_chunk_of_series_is_cut_along_the_longest_other_dimension():
    variable = xr.Variable(("time", "member", "node"), np.empty((1000, 10, 10_000), dtype=np.float32))
    assert zarr_store._chunk(variable, "series") == (1000, 10, 104)
    assert zarr_store._chunk(variable, "maps") == (10, 10, 10_000)


def test_what_cannot_be_written_is_one_line(run, tmp_path, monkeypatch):
    with pytest.raises(RunError, match="chunks must be one of maps, series, got 'rows'"):
        run.dafw.to_zarr(tmp_path / "a.zarr", "rows")
    (tmp_path / "b.zarr").mkdir()
    with pytest.raises(RunError, match=r"b\.zarr: exists already; nothing was changed"):
        run.dafw.to_zarr(tmp_path / "b.zarr")
    with monkeypatch.context() as patched:
        patched.setattr(xr.Dataset, "to_zarr", lambda *_, **__: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            run.dafw.to_zarr(tmp_path / "c.zarr")
    monkeypatch.setitem(sys.modules, "zarr", None)
    with pytest.raises(RunError, match=r"pip install 'dafw\[zarr\]'"):
        run.dafw.to_zarr(tmp_path / "d.zarr")
    assert sorted(one.name for one in tmp_path.iterdir()) == ["b.zarr", "run.nc"]
