"""What a site's buildings are not, compared with the footprints of its file: for pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import shapely

from dafw.plugins.models.dispersion.site.geojson import read_outlines
from dafw.plugins.models.dispersion.site.options import SiteOptions
from dafw.plugins.models.dispersion.site.site import REPORT, Site, file_of

NOTICEABLE = 0.1
"""m; thinner differences are those of rounding to the grid of the overlays."""


@dataclass(frozen=True)
class Changes:
    """All in metres about the centre of the site.

    Attributes:
        added: ground that the site takes for a building and the file does not: yards, gaps, holes.
        removed: ground of footprints that is free in the site: what lies in the rim or is too thin or too small.
        outside: ground of footprints beyond the limits.
        crossing: the footprints whose rings cross themselves.
    """

    added: Any
    removed: Any
    outside: Any
    crossing: tuple[Any, ...]


def changes_of(site: Site, options: SiteOptions) -> Changes:
    """Return what was done to the footprints of the file of a site; raises SiteError if it cannot be read."""
    solids, crossing = [], []
    for outline in read_outlines(file_of(options), dict.fromkeys(REPORT, 0)):
        rings = [ring for ring in map(site.to_metres, outline.rings) if len(ring) >= 4]
        if not rings:
            continue
        polygon = shapely.Polygon(rings[0], rings[1:])
        if not shapely.Polygon(rings[0]).is_valid:
            crossing.append(polygon)
        solids.append(shapely.make_valid(polygon, method="structure", keep_collapsed=False))
    drawn, limits = shapely.union_all(solids), shapely.box(*site.bounds)
    kept = shapely.union_all(list(site.buildings))
    return Changes(
        added=_noticeable(kept.difference(drawn)),
        removed=_noticeable(drawn.intersection(limits).difference(kept)),
        outside=_noticeable(drawn.difference(limits)),
        crossing=tuple(crossing),
    )


def _noticeable(difference: Any) -> Any:
    """Return what somebody could see of a difference."""
    seen = difference.buffer(-NOTICEABLE / 2, join_style="mitre").buffer(NOTICEABLE / 2, join_style="mitre")
    return shapely.MultiPolygon([piece for piece in shapely.get_parts(seen) if not piece.is_empty])
