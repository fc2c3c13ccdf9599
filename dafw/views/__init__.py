"""Pictures of finished or interrupted runs, drawn from what is in ``run.nc`` and nothing else.

Every ``plot_*`` function takes a dataset as ``xarray.open_dataset(run.nc)`` gives it and returns a matplotlib Figure
that needs no display and no global state. Importing this package loads matplotlib: do it where a picture is wanted.
"""

from __future__ import annotations

from dafw.views.files import compare, draw_all, draw_runs
from dafw.views.innovations import plot_innovations
from dafw.views.maps import plot_contours, plot_route
from dafw.views.section import plot_section
from dafw.views.series import plot_errors, plot_parameters, plot_state

__all__ = [
    "compare",
    "draw_all",
    "draw_runs",
    "plot_contours",
    "plot_errors",
    "plot_innovations",
    "plot_parameters",
    "plot_route",
    "plot_section",
    "plot_state",
]
