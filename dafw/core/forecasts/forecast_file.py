"""The file ``forecast.nc`` of a run: one row for each forecast. docs/forecasts.md lists the names in it.

A row's ``issue`` is written last, and the file is synchronised then. So a run that is stopped or killed leaves a file
that opens, and a row without ``issue`` is none.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np

from dafw.core.checkpoints.journal import Journal
from dafw.core.cycle import Parts
from dafw.core.errors import CheckpointError, RunError
from dafw.core.files import made_anew
from dafw.core.forecasts.ahead import Ahead, Course
from dafw.core.forecasts.areas import Places
from dafw.core.forecasts.chances import chance, exceeded
from dafw.core.forecasts.plan import ForecastPlan
from dafw.core.quantiles import quantile
from dafw.core.run_layout import CACHE
from dafw.core.runs import NO_TIME
from dafw.core.space import Array
from dafw.core.ugrid import write_domain

FILE = "forecast.nc"
SINGLES = ("truth", "free")
"""What else is run ahead to judge forecasts by; its variables end in its name."""
LATER = "missing: not within the horizon with that probability"


class ForecastFile:
    """A new file for the forecasts of a run.

    ``singles`` names those of truth and free run that are run ahead, too; ``start`` is the first belief's field (N, n)
    with its weights, by which the guess "the gas stays where it was released" is judged. A ``journal`` is told of every
    forecast; ``before`` are the entries of one: the file is made anew from them and takes its place at the end. Raises
    RunError if there is such a file already.
    """

    def __init__(
        self,
        path: Path,
        parts: Parts,
        plan: ForecastPlan,
        places: Places,
        *,
        singles: tuple[str, ...],
        start: tuple[Array, Array | None],
        attributes: Mapping[str, str | int],
        journal: Journal | None = None,
        before: Iterable[tuple[dict[str, Any], dict[str, Array]]] | None = None,
    ) -> None:
        self._plan, self._places, self._singles = plan, places, singles
        variable = parts.model.space.variables[0]
        self._name, self._units = variable.name, variable.units
        self._on_mesh: dict[str, str] = {}
        self._journal = journal
        beside = path if before is None else made_anew(path)
        try:
            self._file = netCDF4.Dataset(beside, "w", clobber=False, format="NETCDF4")
        except OSError as error:
            raise RunError(f"{path}: cannot be written, or is there already ({error})") from error
        self._file.setncatts(
            {
                "Conventions": "CF-1.11 UGRID-1.0",
                "scored_variable": variable.name,
                "horizon": plan.horizon,
                **attributes,
            }
        )
        self._coordinates(variable.size, variable.coordinates)
        domain = parts.model.domain
        if domain is not None:
            write_domain(self._file, domain)
            if domain.triangles is not None:
                self._on_mesh = {"mesh": "mesh2d", "location": "node", "coordinates": "node_x node_y"}
        self._define_places("", "node", "")
        for kind, peaks in (("area", places.areas), ("building", places.buildings)):
            if peaks.areas:
                self._names(kind, peaks.names)
                self._define_places(f"{kind}_", kind, f", largest in the {kind}")
        if places.areas.areas:
            self._file.createDimension("member", len(start[0]))
            text = "lead time when the threshold is first exceeded in the area, by member"
            self._define("area_arrival_time_members", ("issue", "threshold", "member", "area"), "s", text)
            self._define("weight", ("issue", "member"), "1", "weights of the members")
        if singles:
            self._released(*start)
        self._row = 0
        if before is not None:
            self._repeat(before)
            beside.replace(path)
        self._file.sync()

    def _repeat(self, entries: Iterable[tuple[dict[str, Any], dict[str, Array]]]) -> None:
        try:
            for told, arrays in entries:
                self._write(float(told["issue"]), arrays)
        except (LookupError, TypeError, ValueError) as error:
            raise CheckpointError(f"its forecasts do not fit the study ({type(error).__name__}: {error})") from error

    def _coordinates(self, size: int, coordinates: Array | None) -> None:
        plan, file = self._plan, self._file
        file.createDimension("issue", None)
        file.createDimension("node", size)
        for name, values, units, attributes in (
            ("lead", plan.leads, "s", {"standard_name": "forecast_period", "long_name": "time since the issue"}),
            ("threshold", plan.limits, self._units, {"long_name": "value that may be exceeded"}),
            ("quantile", plan.shares, "1", {"long_name": "probability of a quantile"}),
            ("probability", plan.probabilities, "1", {"long_name": "probability of exceedance"}),
        ):
            file.createDimension(name, len(values))
            made = file.createVariable(name, "f8", (name,))
            made[:] = values
            made.setncatts({"units": units, **attributes})
        long_name = "time since the start at which the forecast was made"
        # No `axis`, no `standard_name`: for CF those are of times since a date, and a study has none.
        self._define("issue", ("issue",), "s", long_name)
        self._define("valid_time", ("issue", "lead"), "s", "time since the start that a map is of")
        for axis, column in zip("xyz", () if coordinates is None else coordinates.T, strict=False):
            made = file.createVariable(f"node_{axis}", "f8", ("node",))
            made[:] = column
            made.setncatts({"units": "m", "long_name": f"{axis} coordinate of the nodes"})

    def _names(self, kind: str, names: list[str]) -> None:
        self._file.createDimension(kind, len(names))
        made = self._file.createVariable(f"{kind}_name", str, (kind,))
        made[:] = np.array(names, dtype=object)
        made.long_name = f"name of the {kind}"

    def _define(self, name: str, dims: tuple[str, ...], units: str, long_name: str, **attributes: Any) -> None:
        dtype = "f4" if "node" in dims else "f8"
        sizes = [1 if dim == "issue" else len(self._file.dimensions[dim]) for dim in dims]
        # A coordinate has no missing values (CF), so a row that is not complete has netCDF's own large number there.
        fill = None if dims == (name,) else np.nan
        made = self._file.createVariable(name, dtype, dims, fill_value=fill, chunksizes=sizes, chunk_cache=CACHE)
        made.setncatts({"units": units, "long_name": long_name, **attributes})
        made.set_auto_maskandscale(False)

    def _define_places(self, prefix: str, dim: str, where: str) -> None:
        """Define what is told of the nodes, of areas or of buildings."""
        mesh = self._on_mesh if dim == "node" else {"coordinates": f"{dim}_name"}
        name, units, dosed = self._name, self._units, _times_seconds(self._units)
        title = name.replace("_", " ")
        maps, per_threshold = ("issue", "lead", "threshold", dim), ("issue", "threshold", dim)
        times = ("issue", "threshold", "quantile", dim)
        arrival, clearing = "lead time when the threshold is first exceeded", "lead time from which it is not exceeded"
        for full, dims, its_units, text, more in (
            ("exceedance_probability", maps, "1", f"probability that the {title} exceeds the threshold{where}", {}),
            ("reach_probability", per_threshold, "1", f"the same, at any time within the horizon{where}", {}),
            ("arrival_time", times, "s", f"{arrival}{where}", {"comment": LATER}),
            ("clearing_time", times, "s", f"{clearing}{where}", {"comment": f"0: it never is; {LATER}"}),
            ("dose", ("issue", "quantile", dim), dosed, f"integral of the {title} over the horizon{where}", {}),
            ("dose_mean", ("issue", dim), dosed, f"its mean{where}", {}),
            (
                f"{name}_exceeded",
                ("issue", "lead", "probability", dim),
                units,
                f"{title} that is exceeded with the probability{where}",
                {},
            ),
        ):
            self._define(f"{prefix}{full}", dims, its_units, text, **more, **mesh)
        for single in self._singles:
            label = {"truth": "truth", "free": "free run"}[single]
            for full, dims, its_units, text in (
                (name, ("issue", "lead", dim), units, f"{title}{where}"),
                ("arrival_time", per_threshold, "s", f"{arrival}{where}"),
                ("clearing_time", per_threshold, "s", f"{clearing}{where}"),
                ("dose", ("issue", dim), dosed, f"integral of the {title} over the horizon{where}"),
            ):
                comment = {"comment": "missing: not within the horizon"} if its_units == "s" else {}
                self._define(f"{prefix}{full}_{single}", dims, its_units, f"{text}, {label}", **comment, **mesh)

    def _released(self, field: Array, weights: Array | None) -> None:
        """Write the first belief: the guess that the gas stays where it was released."""
        title = f"probability that the {self._name.replace('_', ' ')} of the first belief exceeds the threshold"
        limits = self._plan.limits
        for prefix, dim, values in (
            ("", "node", field),
            ("area_", "area", self._places.areas.of(field)),
            ("building_", "building", self._places.buildings.of(field)),
        ):
            if dim not in self._file.dimensions:
                continue
            mesh = self._on_mesh if dim == "node" else {}
            self._define(f"{prefix}exceedance_probability_released", ("threshold", dim), "1", title, **mesh)
            chances = [chance(values > limit, weights) for limit in limits]
            self._file.variables[f"{prefix}exceedance_probability_released"][:] = chances
        name = f"{self._name}_exceeded_released"
        self._define(name, ("probability", "node"), self._units, "the same of the first belief", **self._on_mesh)
        self._file.variables[name][:] = [exceeded(field, weights, p) for p in self._plan.probabilities]

    def write(self, belief: Ahead, singles: Mapping[str, Ahead]) -> None:
        """Add a forecast and synchronise the file."""
        values: dict[str, Any] = {"valid_time": belief.time + np.array(self._plan.leads)}
        for prefix, kind in (("", "nodes"), ("area_", "areas"), ("building_", "buildings")):
            course: Course = getattr(belief, kind)
            if not course.dose.shape[-1]:
                continue
            values |= {f"{prefix}{name}": found for name, found in told_of(course, self._plan, self._name).items()}
            for single, ahead in singles.items():
                own: Course = getattr(ahead, kind)
                values |= {
                    f"{prefix}{self._name}_{single}": own.values[:, 0],
                    f"{prefix}arrival_time_{single}": _known(own.arrival[:, 0]),
                    f"{prefix}clearing_time_{single}": _known(own.clearing[:, 0]),
                    f"{prefix}dose_{single}": own.dose[0],
                }
        if self._places.areas.areas:
            weights, size = belief.areas.weights, len(belief.areas.dose)
            values["area_arrival_time_members"] = _known(belief.areas.arrival)
            values["weight"] = np.full(size, 1.0 / size) if weights is None else weights
        self._write(belief.time, values)
        if self._journal is not None:
            self._journal.add({"issue": belief.time}, values)

    def _write(self, issue: float, values: Mapping[str, Any]) -> None:
        for name, found in values.items():
            self._file.variables[name][self._row] = found
        self._file.variables["issue"][self._row] = issue
        self._file.sync()
        self._row += 1

    @property
    def is_open(self) -> bool:
        """Whether forecasts can still be added."""
        return bool(self._file.isopen())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def told_of(course: Course, plan: ForecastPlan, name: str) -> dict[str, Array]:
    """Return what a forecast says of places, by the names of ``forecast.nc``; ``name`` is the scored variable's."""
    weights = course.weights
    above = course.values[:, np.newaxis] > np.array(plan.limits)[:, np.newaxis, np.newaxis]

    def times(values: Array) -> Array:
        return np.stack([[_known(quantile(one, weights, p)) for p in plan.shares] for one in values])

    return {
        "exceedance_probability": np.stack([[chance(one, weights) for one in lead] for lead in above]),
        "reach_probability": np.stack([chance(np.isfinite(one), weights) for one in course.arrival]),
        "arrival_time": times(course.arrival),
        "clearing_time": times(course.clearing),
        "dose": np.stack([quantile(course.dose, weights, p) for p in plan.shares]),
        "dose_mean": chance_mean(course.dose, weights),
        f"{name}_exceeded": np.stack(
            [[exceeded(one, weights, p) for p in plan.probabilities] for one in course.values]
        ),
    }


def chance_mean(values: Array, weights: Array | None) -> Array:
    """Return the mean (...) of values (N, ...) over weighted members."""
    return np.asarray(values.mean(axis=0) if weights is None else np.tensordot(weights, values, axes=1))


def _known(times: Array) -> Array:
    """Return times with NaN for those that do not come."""
    return np.where(np.isfinite(times), times, np.nan)


def _times_seconds(units: str) -> str:
    return "s" if units in ("", "1") else f"{units} s"


def open_forecasts(path: str | Path) -> Any:
    """Open the forecasts of a run's folder, or a ``forecast.nc``, as a lazy xarray.Dataset; also while the run goes on.

    Raises RunError if there are none or the file cannot be read.
    """
    import xarray

    from dafw.core.run_store import opened_store

    file = Path(path) / FILE if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise RunError(f"{path}: holds no forecasts (expected a run's folder with {FILE}, or that file)")
    with opened_store(file) as store:
        found = xarray.open_dataset(store, decode_times=False)
        if "issue" not in found.variables:  # a run is making the file just now, or it is another one
            raise RunError(f"{file}: holds no forecasts (expected the variable 'issue')")
        return found.isel(issue=np.flatnonzero(found["issue"].values < NO_TIME))
