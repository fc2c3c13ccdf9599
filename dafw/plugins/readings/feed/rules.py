"""What a study expects of readings, from the options of its feed and its state space."""

from __future__ import annotations

from collections.abc import Mapping

from dafw.core.space import StateSpace
from dafw.plugins.readings.feed.desk import Rules
from dafw.plugins.readings.feed.messages import names_of
from dafw.plugins.readings.feed.options import FeedOptions
from dafw.plugins.readings.files.sensors import ErrorOptions


def rules_of(
    options: FeedOptions,
    space: StateSpace,
    has_degrees: bool,
    errors: Mapping[str, ErrorOptions],
    common: ErrorOptions,
) -> Rules:
    """Return what is expected; ``errors`` are those by sensor, ``has_degrees``: the plane has a place on Earth."""
    variable = space.variables[0] if options.variable is None else space[options.variable]
    places: tuple[str, ...] = ("entry",)
    if variable.coordinates is not None and variable.coordinates.shape[1] == 2:
        places = ("metres", *(["degrees"] if has_degrees else []), "entry")
    if options.entries or options.paths or variable.size == 1:
        places = ()
    return Rules(
        names=names_of(options.columns),
        wanted=options.reference or variable.units,
        errors=errors,
        common=common,
        places=places,
        size=variable.size,
        plausible=variable.plausible,
        known=frozenset(options.entries or options.paths) or None,
        entries=options.entries,
        vehicles={name: number for number, name in enumerate(options.vehicles)},
        unit=options.unit,
        time_format=options.time_format,
        lowest=options.lowest,
        highest=options.highest,
        first=options.start == "first",
        stamped=options.clock == "wall",
        furthest=options.furthest,
        most=options.most,
    )
