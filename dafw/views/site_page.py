"""What the page shows on which release and drones are placed, as numbers and texts for its scripts."""

from __future__ import annotations

from typing import Any

import numpy as np

from dafw.views.report_fields import deflated_numbers
from dafw.views.site_places import Places, Point
from dafw.views.site_preview import Preview

MOST_NODES = 60_000
"""Of a mesh that is drawn; the lines of a larger one would cover everything."""


def page_of_site(preview: Preview) -> dict[str, Any]:
    """Return everything that the page shows of a study on a site, with release and drones on free ground."""
    site, places = preview.site, preview.free_places
    x_min, y_min, x_max, y_max = site.bounds
    rim = preview.model.site.rim
    changes = preview.changes
    size = f"{x_max - x_min:.0f} m x {y_max - y_min:.0f} m, {len(site.buildings)} buildings"
    return {
        "title": "Place the release and the drone" if places.drones else "Place the release",
        "subtitle": f"{preview.file} · {size}",
        "live": True,
        "map": {**_mesh(preview), "extent": [x_min, x_max, y_min, y_max], "buildings": _rings(site.buildings)},
        "rim": [x_min + rim, y_min + rim, x_max - rim, y_max - rim],
        "changes": {
            "added": _rings(changes.added.geoms),
            "removed": _rings(changes.removed.geoms),
            "crossing": _rings(changes.crossing),
        },
        "readings": {"row": []},
        "radius": preview.model.release_radius,
        "further": [{"x": x, "y": y} for _, (x, y) in preview.further],
        "spots": [
            {"name": name, "x": x, "y": y, "about": preview.about(name, (x, y))}
            for name, (x, y) in preview.named(places)
        ],
        **_winds(preview),
        "command": preview.command(places),
        "words": [
            {"title": "What was read", "lines": site.report_lines()},
            {"title": "What it takes", "lines": preview.size_lines()},
        ],
        "attribution": preview.attribution,
    }


def answer_to(preview: Preview, at: list[Point]) -> dict[str, Any]:
    """Return the command that puts release and drones at some places, with a line about each, or the ``problem``.

    Args:
        preview: the study.
        at: the place of the release, and those of all drones.
    """
    places = Places(at[0], tuple(at[1:]))
    named = preview.named(places)
    for name, place in named:
        if problem := preview.ground.problem(place):
            return {"problem": f"({place[0]:g}, {place[1]:g}) m {problem}: the {name} stays where it was."}
    return {"command": preview.command(places), "about": [preview.about(name, place) for name, place in named]}


def _mesh(preview: Preview) -> dict[str, str]:
    nodes, triangles = preview.mesh
    if len(nodes) > MOST_NODES:
        return {"x": "", "y": "", "triangles": ""}
    return {
        "x": deflated_numbers(nodes[:, 0], "<f4"),
        "y": deflated_numbers(nodes[:, 1], "<f4"),
        "triangles": deflated_numbers(triangles, "<u4"),
    }


def _rings(polygons: Any) -> list[list[list[float]]]:
    return [np.round(np.asarray(polygon.exterior.coords)[:-1], 2).tolist() for polygon in polygons]


def _winds(preview: Preview) -> dict[str, Any]:
    """Return the winds of truth and first guess, with the colours that the pages have for them."""
    winds = [
        {"role": role, "name": f"wind, {words}: {speed:g} m/s", "speed": speed, "direction": direction}
        for role, words, speed, direction in preview.winds
    ]
    return {"winds": winds, "wind": {"fastest": max(1e-9, *(speed for _, _, speed, _ in preview.winds))}}
