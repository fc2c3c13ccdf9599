"""Reads the file of a run."""

import netCDF4


def contents(folder):
    """Return, by name, the bits of everything in a run's file except the measured times."""
    with netCDF4.Dataset(folder / "run.nc") as file:
        file.set_auto_mask(False)
        return {
            name: variable[...].astype(str).tobytes() if variable.dtype is str else variable[...].tobytes()
            for name, variable in file.variables.items()
            if name != "phase_seconds"
        }
