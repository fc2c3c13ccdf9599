"""What is in the file of a run."""

import netCDF4


def contents(folder):
    """Return the bits of everything in a run's file but the times that it took, by name."""
    with netCDF4.Dataset(folder / "run.nc") as file:
        file.set_auto_mask(False)
        return {
            name: variable[...].astype(str).tobytes() if variable.dtype is str else variable[...].tobytes()
            for name, variable in file.variables.items()
            if name != "phase_seconds"
        }
