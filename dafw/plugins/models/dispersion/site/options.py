"""The options of a site."""

from __future__ import annotations

from dataclasses import dataclass

from dafw.core.options import option


@dataclass
class SiteOptions:
    """Where the buildings come from, and the rectangle around them."""

    file: str = option("plant", "path of a GeoJSON file, or 'plant' for the site that ships with dafw")
    margin: float = option(
        80.0,
        "distance from the outermost buildings to the limits of the site if no bounds are given, in metres",
        minimum=0.0,
    )
    bounds: list[float] | None = option(None, "limits of the site in degrees, [lon_min, lat_min, lon_max, lat_max]")
    rim: float = option(
        20.0, "width of the strip inside the limits that is kept free of buildings, in metres", above=0.0
    )
    narrowest_gap: float = option(
        4.0, "gaps, passages and entrances of yards that are narrower than this are closed, in metres", above=0.0
    )
