"""Runs recorded without a truth or without a free run."""

import xarray as xr


def without_truth(run: xr.Dataset) -> xr.Dataset:
    """The same run, recorded without a truth."""
    names = [str(name) for name in run.data_vars]
    return run.drop_vars([name for name in names if name.endswith("_truth") or name.startswith("err")])


def without_free_run(run: xr.Dataset) -> xr.Dataset:
    """The same run, recorded without a free run."""
    return run.drop_vars([name for name in run.data_vars if str(name).endswith("_free")])
