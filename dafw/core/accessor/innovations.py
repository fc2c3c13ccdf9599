"""How surprising the readings were."""

from __future__ import annotations

import numpy as np
from xarray import DataArray, Dataset

from dafw.core.errors import RunError


def surprise(run: Dataset) -> DataArray:
    """Return every innovation over its expected standard deviation: see ``RunAccessor.surprise``."""
    names = [f"observation_{part}" for part in ("value", "forecast_mean", "forecast_spread", "variance")]
    missing = [name for name in names if name not in run]
    if missing:
        raise RunError(
            f"surprises of readings need {', '.join(missing)}, which this run does not hold: it is of an older dafw; "
            f"innovation_mean and innovation_rms have their mean and root mean square in each cycle"
        )
    value, expected, spread, variance = (run[name] for name in names)
    found = (value - expected) / np.sqrt(spread**2 + variance)
    return found.rename("surprise").assign_attrs(
        units="1", long_name="innovations over the standard deviation that the forecast expects of them"
    )
