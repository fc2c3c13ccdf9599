"""Named areas on a mesh, and the largest value of a field within each of them.

A field on triangles is linear on each. So its largest value within a polygon is that at one of these points: a node in
the polygon, a corner of the polygon, or a place where an edge of the mesh crosses the polygon's boundary. The field at
all of these is a product with a sparse matrix, and the largest value is exact.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dafw.core.domain import Domain
from dafw.core.errors import ConfigurationError, in_one_line
from dafw.core.forecasts.plan import ForecastPlan
from dafw.core.geography import to_metres
from dafw.core.interpolation import weights_at
from dafw.core.space import Array, Variable

AT_THE_WALL = 0.01
"""Distance in metres from a building up to which gas counts as having reached it: the mesh ends at its walls."""


@dataclass(frozen=True)
class Area:
    """A named place: a shapely polygon or multipolygon in metres."""

    name: str
    polygon: Any


def areas_of(plan: ForecastPlan, domain: Domain | None) -> list[Area]:
    """Return the areas that a plan names; raises ConfigurationError, which names the area, if one is not accepted."""
    origin = None if domain is None else domain.origin
    found = [Area(name, _polygon(name, corners, plan.area_units, origin)) for name, corners in plan.areas.items()]
    if plan.area_file is not None:
        found += _from_file(Path(plan.area_file), origin)
    names = [area.name for area in found]
    if twice := {name for name in names if names.count(name) > 1}:
        raise ConfigurationError(f"study, forecast: two areas are called '{min(twice)}'")
    return found


def buildings_of(domain: Domain | None) -> list[Area]:
    """Return the buildings of a domain with a skin of a centimetre, because the mesh ends at their walls."""
    import shapely

    found = []
    for number, ring in enumerate(domain.obstacles if domain is not None else ()):
        names = domain.obstacle_names if domain is not None else ()
        name = names[number] if number < len(names) and names[number] else f"building {number}"
        found.append(Area(name, shapely.buffer(shapely.Polygon(ring), AT_THE_WALL, join_style="mitre")))
    return found


class Peaks:
    """The largest value of a field in each of some areas.

    ``variable`` is the field's, ``domain`` has its triangles. Raises ConfigurationError if an area holds no point of
    the mesh, or if there is no mesh.
    """

    def __init__(self, areas: Sequence[Area], variable: Variable, domain: Domain | None, *, skip: bool = False) -> None:
        from scipy.sparse import csr_array

        self.areas: list[Area] = []
        size, rows = variable.size, []
        starts, count = [], 0
        mesh = _Mesh(variable, domain) if areas else None
        for area in areas:
            found = mesh.points_in(area) if mesh is not None else None
            if found is None and skip:
                continue
            if found is None:
                bounds = [] if domain is None else [round(bound, 1) for bound in domain.bounds]
                raise ConfigurationError(
                    f"study, forecast: area '{area.name}' holds no place of the model's domain: expected corners "
                    f"within {bounds} m, not inside a building"
                )
            self.areas.append(area)
            starts.append(count)
            rows.append(found)
            count += found.shape[0]
        self._starts = np.array(starts, dtype=np.int64)
        if rows:
            from scipy.sparse import vstack

            self._matrix = csr_array(vstack(rows))
        else:
            self._matrix = csr_array((0, size))

    @property
    def names(self) -> list[str]:
        """The areas' names."""
        return [area.name for area in self.areas]

    def of(self, values: Array) -> Array:
        """Return the largest values (..., A) of fields (..., n) in the areas."""
        if not self.areas:
            return np.empty((*values.shape[:-1], 0))
        flat = np.asarray(values, dtype=np.float64).reshape(-1, values.shape[-1])
        at_points = (self._matrix @ flat.T).T
        return np.asarray(np.maximum.reduceat(at_points, self._starts, axis=1)).reshape(*values.shape[:-1], -1)


@dataclass(frozen=True)
class Places:
    """The areas and the buildings of which a forecast tells."""

    areas: Peaks
    buildings: Peaks


def places_of(plan: ForecastPlan, variable: Variable, domain: Domain | None) -> Places:
    """Return the areas of a plan and the buildings of a domain on the mesh of a variable; raises ConfigurationError.

    A model without a mesh of triangles has no buildings here. Those that the mesh does not touch are left out.
    """
    meshed = domain is not None and domain.triangles is not None
    buildings = buildings_of(domain) if meshed else []
    return Places(Peaks(areas_of(plan, domain), variable, domain), Peaks(buildings, variable, domain, skip=True))


class _Mesh:
    """What finds the points of a mesh that lie in a polygon."""

    def __init__(self, variable: Variable, domain: Domain | None) -> None:
        import shapely

        nodes, triangles = variable.coordinates, None if domain is None else domain.triangles
        if nodes is None or triangles is None:
            raise ConfigurationError("study, forecast: areas need a model with a mesh of triangles, this one has none")
        self.variable, self.triangles, self.nodes = variable, triangles, nodes
        pairs = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        self.edges = np.unique(pairs, axis=0).astype(np.int64)
        self._lines = shapely.linestrings(nodes[self.edges])
        self._line_tree, self._node_tree = shapely.STRtree(self._lines), shapely.STRtree(shapely.points(nodes))

    def points_in(self, area: Area) -> Any:
        """Return the matrix (points, n) that gives a field at all points that decide its largest value in an area.

        None if the mesh has no place in it.
        """
        import shapely
        from matplotlib.tri import Triangulation
        from scipy.sparse import coo_array

        inside = np.sort(self._node_tree.query(area.polygon, predicate="intersects"))
        indices = [np.stack([inside, inside, inside], axis=1)]
        weights = [np.tile([1.0, 0.0, 0.0], (len(inside), 1))]
        boundary = area.polygon.boundary
        crossed = np.sort(self._line_tree.query(boundary, predicate="intersects"))
        if len(crossed):
            met, edge = shapely.get_coordinates(shapely.intersection(self._lines[crossed], boundary), return_index=True)
            first, last = self.edges[crossed[edge]].T
            along = self.nodes[last] - self.nodes[first]
            share = np.clip(np.sum((met - self.nodes[first]) * along, axis=1) / np.sum(along**2, axis=1), 0.0, 1.0)
            indices.append(np.stack([first, last, last], axis=1))
            weights.append(np.stack([1.0 - share, share, 0.0 * share], axis=1))
        corners = shapely.get_coordinates(area.polygon)
        within = Triangulation(*self.nodes.T, self.triangles).get_trifinder()(*corners.T) >= 0
        if within.any():
            at, shares = weights_at(self.variable, self.triangles, corners[within])
            indices.append(at)
            weights.append(shares)
        columns, values = np.concatenate(indices), np.concatenate(weights)
        if not len(columns):
            return None
        rows = np.repeat(np.arange(len(columns)), 3)
        shape = (len(columns), self.variable.size)
        return coo_array((values.ravel(), (rows, columns.ravel())), shape=shape).tocsr()


def _polygon(name: str, corners: Sequence[Sequence[float]], units: str, origin: tuple[float, float] | None) -> Any:
    """Return corners as a polygon in metres; raises ConfigurationError."""
    import shapely

    places = np.array(corners, dtype=np.float64)
    if units == "degrees":
        places = _in_metres(name, places, origin)
    return _accepted(name, shapely.Polygon(places))


def _in_metres(name: str, degrees: Array, origin: tuple[float, float] | None) -> Array:
    if origin is None:
        raise ConfigurationError(
            f"study, forecast: area '{name}' is given in longitude and latitude, but the model's plane has no place on "
            f"Earth: expected corners in metres (areas, area_units: metres)"
        )
    return to_metres(degrees, origin)


def _accepted(name: str, polygon: Any) -> Any:
    if not polygon.is_valid or polygon.area <= 0.0:
        raise ConfigurationError(f"study, forecast: area '{name}' is no polygon: its sides cross, or it has no width")
    return polygon


def _from_file(path: Path, origin: tuple[float, float] | None) -> list[Area]:
    """Return the polygons of a GeoJSON file (RFC 7946: longitude, latitude); raises ConfigurationError."""
    import shapely

    where = f"study, forecast: {path}"
    try:
        document = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigurationError(f"{where}: cannot be read as GeoJSON ({' '.join(str(error).split())})") from None
    features = document.get("features") if isinstance(document, Mapping) else None
    if not isinstance(features, list) or not features:
        raise ConfigurationError(f"{where}: expected a FeatureCollection with polygons")
    found = []
    for number, feature in enumerate(features, 1):
        properties = feature.get("properties") if isinstance(feature, Mapping) else None
        name = properties.get("name") if isinstance(properties, Mapping) else None
        if not isinstance(name, str) or not name:
            raise ConfigurationError(f"{where}: feature {number}: expected a property 'name' with a text")
        geometry = feature.get("geometry")
        kind = geometry.get("type") if isinstance(geometry, Mapping) else None
        if kind not in ("Polygon", "MultiPolygon"):
            raise ConfigurationError(f"{where}: area '{name}': expected a Polygon or MultiPolygon, got {kind}")
        try:
            polygon = shapely.from_geojson(json.dumps(geometry))
        except (shapely.errors.GEOSException, ValueError) as error:
            text = f"{where}: area '{name}': cannot be read as GeoJSON ({in_one_line(error)})"
            raise ConfigurationError(text) from None
        if not np.isfinite(shapely.get_coordinates(polygon)).all():
            raise ConfigurationError(f"{where}: area '{name}': expected finite numbers")
        moved = shapely.transform(polygon, lambda degrees, called=name: _in_metres(called, degrees, origin))
        found.append(Area(name, _accepted(name, moved)))
    return found
