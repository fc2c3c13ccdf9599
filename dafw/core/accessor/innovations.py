"""How surprising the readings were."""

from __future__ import annotations

import numpy as np
from xarray import DataArray, Dataset

from dafw.core.errors import RunError

NEEDED = tuple(f"observation_{part}" for part in ("value", "forecast_mean", "forecast_spread", "variance"))


def has_surprises(run: Dataset) -> bool:
    """Return whether the file has all that is needed; a file of an older dafw has not."""
    return set(NEEDED) <= set(run.variables)


def surprise(run: Dataset) -> DataArray:
    """Return every innovation over its expected standard deviation: see ``RunAccessor.surprise``."""
    if not has_surprises(run):
        raise RunError(
            f"surprises of readings need {', '.join(NEEDED)}, which this run does not all hold: it may be of an older "
            f"dafw; innovation_mean and innovation_rms have their mean and root mean square in each cycle"
        )
    value, expected, spread, variance = (run[name] for name in NEEDED)
    found = (value - expected) / np.sqrt(spread**2 + variance)
    return found.rename("surprise").assign_attrs(
        units="1", long_name="innovations over the standard deviation that the forecast expects of them"
    )
