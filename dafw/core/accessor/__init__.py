"""``run.dafw``: what one asks of a run afterwards, on every xarray Dataset once ``dafw.open_run`` was called.

Values are xarray objects with the dimensions of the run, and of a sweep (``dafw.open_sweep``) the swept parameters in
front. They are computed at once from a run, and when they are used from a sweep or from members of more than 128 MiB.
docs/post-analysis.md has an example of each method.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray
from xarray import DataArray, Dataset

from dafw.core.accessor import contour_lines, innovations, moments, places, scores, table, zarr_store

if TYPE_CHECKING:
    import pandas

    from dafw.core.accessor.contour_lines import Contour


@xarray.register_dataset_accessor("dafw")
class RunAccessor:
    """The methods of ``run.dafw``. ``name`` is a state variable, by default the scored one.

    ``of`` says which estimate is meant: ``belief`` (after the readings are used), ``forecast`` (before), ``smoothed``
    (as last revised) or, for errors, ``free`` (the free run). A ``field`` is a state variable (its mean), any variable
    of the run's file with the dimension ``node``, or a DataArray such as ``run.dafw.quantile(...)``. All methods raise
    RunError, which says what is missing, if the run does not hold what is asked for.
    """

    def __init__(self, run: Dataset) -> None:
        self._run = run

    def mean(self, name: str | None = None, of: str = "belief") -> DataArray:
        """Return the mean (time, node): circular for angles, geometric for positive variables, weighted.

        From the members if they were recorded and the belief is asked for, otherwise as recorded.
        """
        return moments.mean(self._run, name, of)

    def spread(self, name: str | None = None, of: str = "belief") -> DataArray:
        """Return the sample standard deviation (time, node), likewise; of the logarithm for positive variables."""
        return moments.spread(self._run, name, of)

    def quantile(self, name: str | None, q: float | Sequence[float]) -> DataArray:
        """Return quantiles (time, node) of the belief, for several ``q`` with the dimension ``quantile`` in front.

        Angles are measured from their circular mean. With weights it is the smallest member at which the cumulative
        weight reaches ``q``. Needs recorded members.
        """
        return moments.quantile(self._run, name, q)

    def err(self, name: str | None = None, of: str = "belief") -> DataArray:
        """Return ERR (time,): ``|truth - estimate| / |truth|`` in per cent; ``run["err"]`` for the scored variable."""
        return scores.err(self._run, name, of)

    def rmse(self, name: str | None = None, of: str = "belief") -> DataArray:
        """Return the root mean square (time,) of the estimate's error over the nodes."""
        return scores.rmse(self._run, name, of)

    def crps(self, name: str | None = None, *, each: bool = False) -> DataArray:
        """Return the continuous ranked probability score (time,) of the members: its mean over the nodes.

        With ``each`` that of each node (time, node). Smaller is better; of a single member it is the absolute error.
        Angles are compared the short way round, positive variables by their logarithms. Needs recorded members.
        """
        return scores.crps(self._run, name, each=each)

    def at(self, field: str | DataArray, points: Any) -> DataArray:
        """Return a field (time, point) at ``points`` (m, 2) in metres, linear between the nodes of the mesh.

        NaN outside the mesh, so also in buildings.
        """
        return places.at(self._run, field, points)

    def along(self, field: str | DataArray, line: Any, step: float) -> DataArray:
        """Return a field (time, distance) along a line, every ``step`` metres and at the end of it.

        ``line`` is a polyline (k, 2) in metres or a shapely line.
        """
        return places.along(self._run, field, line, step)

    def contours(
        self,
        field: str | DataArray,
        levels: float | Sequence[float],
        time: float | Sequence[float] | None = None,
        *,
        filled: bool = False,
    ) -> list[Contour]:
        """Return where a field equals each level, as shapely lines in metres; with ``filled`` where it is above it.

        ``time`` in seconds, one or several: the nearest recorded row; the last row by default. Each result has
        ``time``, ``level`` and ``geometry``, which is empty if the level does not occur.
        """
        return contour_lines.contours(self._run, field, levels, time, filled=filled)

    def to_geojson(
        self,
        path: str | Path,
        field: str | DataArray,
        levels: float | Sequence[float],
        time: float | Sequence[float] | None = None,
        *,
        filled: bool = False,
    ) -> Path:
        """Write ``contours`` in longitude and latitude (WGS 84) as a GeoJSON file, and return its path.

        Every line or area has the properties ``variable``, ``units``, ``time`` and ``level``. The file appears complete
        or not at all. Empty contours are left out.
        """
        return contour_lines.to_geojson(self._run, Path(path), field, levels, time, filled=filled)

    def to_zarr(self, path: str | Path, chunks: str = "maps") -> Path:
        """Write the run, or the sweep, as a zarr store into the folder ``path``, and return it.

        ``chunks`` suit how it will be read: ``maps`` at a time, or ``series`` at a node. It appears complete or not at
        all. Needs zarr: ``pip install 'dafw[zarr]'``.
        """
        return zarr_store.to_zarr(self._run, Path(path), chunks)

    def surprise(self) -> DataArray:
        """Return (time, observation) the innovations over the standard deviations that the forecast expects of them.

        If the spread of the belief matches its error, their mean is near 0 and their standard deviation near 1.
        """
        return innovations.surprise(self._run)

    def table(self) -> pandas.DataFrame:
        """Return a sweep as a table: a row a run, with its parameters and the numbers of its ``summary.json``."""
        return table.table(self._run)
