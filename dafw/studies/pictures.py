"""The pictures with which a run ends."""

from __future__ import annotations

import logging
import sys
from pathlib import Path

from dafw.core.errors import DafwError
from dafw.core.forecasts.forecast_file import FILE

log = logging.getLogger("dafw")


def draw_pictures(folder: Path) -> None:
    """Draw a run; a picture that cannot be drawn is a warning."""
    from dafw.core.runs import open_run
    from dafw.views import draw_all

    try:
        with open_run(folder, indexed=False) as run:
            for path in draw_all(run, folder / "figures"):
                log.info("picture %s", path.name)
        if (folder / FILE).exists():
            from dafw.views.forecasts import draw_forecast

            for path in draw_forecast(folder):
                log.info("picture %s", path.name)
    except DafwError as error:
        log.warning("a picture cannot be drawn: %s", error)
        print(f"dafw: the run is complete, but a picture cannot be drawn: {error}", file=sys.stderr)
