"""The options of a site."""

from __future__ import annotations

from dataclasses import dataclass

from dafw.core.options import option


@dataclass
class SiteOptions:
    """Where the buildings come from, and the rectangle around them."""

    file: str = option("plant", "'plant', the site that ships with dafw, or the path of a GeoJSON file")
    margin: float = option(
        80.0, "m; distance from the outermost buildings to the limits, if no bounds are given", minimum=0.0
    )
    bounds: list[float] | None = option(None, "degrees; the limits as [lon_min, lat_min, lon_max, lat_max]")
    rim: float = option(20.0, "m; strip inside the limits that is kept free of buildings", above=0.0)
    narrowest_gap: float = option(4.0, "m; narrower gaps, passages and mouths of yards are closed", above=0.0)
