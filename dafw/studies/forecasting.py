"""The forecasts of a run: made when they are due, written to ``forecast.nc`` and as GeoJSON, logged."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from dafw.core.checkpoints.journal import Journal
from dafw.core.cycle import Parts, State
from dafw.core.errors import DivergenceError, SolverError
from dafw.core.files import write_atomically
from dafw.core.forecasts.ahead import SINGLES, Ahead, run_ahead
from dafw.core.forecasts.areas import places_of
from dafw.core.forecasts.chances import exceeded
from dafw.core.forecasts.contours import Regions, collection, feature, in_degrees
from dafw.core.forecasts.forecast_file import FILE, ForecastFile, told_of
from dafw.core.forecasts.plan import ForecastPlan
from dafw.core.space import Array

log = logging.getLogger("dafw")

FOLDER = "forecasts"
"""Folder in that of a run with one GeoJSON file for each forecast."""
NO_PLACE = (
    "no polygons are written, because the model's plane has no place on Earth (no longitude and latitude): forecast.nc "
    "has everything in metres"
)


class Forecasting:
    """Makes and writes the forecasts of one run; ``state`` is that at the start.

    A ``journal`` is told of every forecast; ``before`` are the entries of one, and what ``summary`` returned then.
    """

    def __init__(
        self,
        plan: ForecastPlan,
        parts: Parts,
        state: State,
        folder: Path,
        attributes: Mapping[str, str | int],
        journal: Journal | None = None,
        before: tuple[Iterable[tuple[dict[str, Any], dict[str, Array]]], Mapping[str, Any]] | None = None,
    ) -> None:
        self._plan, self._parts, self._folder = plan, parts, folder
        space, domain = parts.model.space, parts.model.domain
        self._variable = space.variables[0]
        self._part = space.slice(self._variable.name)
        self._places = places_of(plan, self._variable, domain)
        self._origin = None if domain is None else domain.origin
        nodes, triangles = self._variable.coordinates, None if domain is None else domain.triangles
        self._regions = None if nodes is None or triangles is None else Regions(nodes, triangles)
        known = {} if before is None else before[1]
        self.issued, self.failed = int(known.get("issued", 0)), int(known.get("failed", 0))
        self.seconds = float(known.get("seconds", 0.0))
        present = {"truth": state.truth, "free": state.free}
        # Without a truth there is nothing that forecasts can be judged by.
        verifies = plan.verify and state.truth is not None
        first = state.belief.ensemble
        self._file = ForecastFile(
            folder / FILE,
            parts,
            plan,
            self._places,
            singles=tuple(name for name in SINGLES if verifies and present[name] is not None),
            start=(first.members[:, self._part], first.weights),
            attributes=attributes,
            journal=journal,
            before=None if before is None else before[0],
        )
        if self._regions is not None and self._origin is None:
            log.warning("forecasts: %s", NO_PLACE)

    def issue(self, state: State) -> str | None:
        """Make and write a forecast; return a warning if the model cannot run that far ahead."""
        begun, time = perf_counter(), state.belief.ensemble.time
        try:
            belief, singles = run_ahead(self._parts, state, self._plan, self._places)
        except (SolverError, DivergenceError) as error:
            self.failed += 1
            return f"no forecast is made, the model cannot run ahead: {error}"
        self._file.write(belief, singles)
        if self._regions is not None and self._origin is not None:
            (self._folder / FOLDER).mkdir(exist_ok=True)
            # Twelve digits tell all times of a long run apart, and hide that the sum of its time steps is rounded.
            file = self._folder / FOLDER / f"issued_{time:.12g}s.geojson"
            write_atomically(file, collection(list(self._features(belief))))
        self.issued += 1
        self.seconds += perf_counter() - begun
        log.info("forecast at t = %g s: %s", time, self._said(belief))
        return None

    def _features(self, belief: Ahead) -> Iterator[dict[str, Any]]:
        """Yield the polygons of a forecast: where thresholds are exceeded, then areas and buildings."""
        regions, origin = self._regions, self._origin
        if regions is None or origin is None:
            return
        common = {"issue": belief.time, "variable": self._variable.name, "units": self._variable.units}
        for row, lead in enumerate(self._plan.leads):
            for probability in sorted(self._plan.contours):
                field = exceeded(belief.nodes.values[row], belief.nodes.weights, probability)
                for limit in self._plan.limits:
                    region = regions.above(field, limit)
                    if region.is_empty:
                        continue
                    told = {"lead": lead, "valid_time": belief.time + lead, "threshold": limit}
                    yield feature(
                        in_degrees(region, origin),
                        {"kind": "exceedance", **common, **told, "probability": probability},
                    )
        for kind, course, peaks in (
            ("area", belief.areas, self._places.areas),
            ("building", belief.buildings, self._places.buildings),
        ):
            if not peaks.areas:
                continue
            found = told_of(course, self._plan, self._variable.name)
            for number, area in enumerate(peaks.areas):
                for row, limit in enumerate(self._plan.limits):
                    named = {"name": area.name, "threshold": limit}
                    chances: dict[str, float] = {"probability": float(found["reach_probability"][row, number])}
                    for name in ("arrival_time", "clearing_time"):
                        for share, value in zip(self._plan.shares, found[name][row, :, number], strict=True):
                            chances[f"{name}_{share:g}"] = float(value)
                    yield feature(in_degrees(area.polygon, origin), {"kind": kind, **common, **named, **chances})

    def _said(self, belief: Ahead) -> str:
        """Return which areas are reached, for the log; of the whole domain if there are no areas."""
        limit = self._plan.limits[0]
        if not self._places.areas.areas:
            told = told_of(belief.nodes, self._plan, self._variable.name)["reach_probability"][0]
            likely = int((told >= 0.5).sum())
            return f"more than {limit:g} with a probability of a half or more at {likely} of {told.size} nodes"
        told = told_of(belief.areas, self._plan, self._variable.name)["reach_probability"][0]
        named = [f"{self._places.areas.names[number]} {told[number]:.2f}" for number in _largest(told)]
        return (
            f"probability of more than {limit:g}: {', '.join(named)}" if named else f"no area has more than {limit:g}"
        )

    def summary(self) -> dict[str, Any]:
        """Return what the summary of the run says of its forecasts."""
        return {"issued": self.issued, "failed": self.failed, "seconds": round(self.seconds, 3)}

    def close(self) -> None:
        """Close the file."""
        if self._file.is_open:
            self._file.close()


def _largest(chances: Array, most: int = 5) -> list[int]:
    """Return the numbers of the areas that are likeliest to be reached, at most ``most``, and none that are not."""
    order = np.argsort(-chances, kind="stable")[:most]
    return [int(number) for number in order if chances[number] > 0.0]
