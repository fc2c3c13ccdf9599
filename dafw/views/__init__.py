"""Pictures of finished or interrupted runs, drawn from ``run.nc`` alone.

Every ``plot_*`` function takes a dataset, as opened by ``xarray.open_dataset``, and returns a matplotlib Figure that
needs no display and no global state. Importing this package loads matplotlib, so import it only to draw.
"""

from __future__ import annotations

from dafw.views.expected import plot_expected
from dafw.views.files import compare, draw_all, draw_runs
from dafw.views.innovations import plot_innovations
from dafw.views.maps import plot_contours, plot_route
from dafw.views.places import plot_places
from dafw.views.section import plot_section
from dafw.views.series import plot_errors, plot_parameters, plot_state
from dafw.views.times import plot_times

__all__ = [
    "compare",
    "draw_all",
    "draw_runs",
    "plot_contours",
    "plot_errors",
    "plot_expected",
    "plot_innovations",
    "plot_parameters",
    "plot_places",
    "plot_route",
    "plot_section",
    "plot_state",
    "plot_times",
]
