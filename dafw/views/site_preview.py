"""What a study is about to do on a site: buildings, mesh, release and drones, before anything long is computed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dafw.core.composition import compose, quoted_override, study_part
from dafw.core.errors import ConfigurationError, OptionError
from dafw.core.experiment import study_from
from dafw.core.study import Study
from dafw.plugins.models.dispersion.model import AdvectionDiffusion
from dafw.plugins.models.dispersion.reduced_wind.expected import bytes_of_process, seconds_of_basis
from dafw.plugins.models.dispersion.site.changes import Changes, changes_of
from dafw.plugins.models.dispersion.site.fetch import attribution_of
from dafw.plugins.models.dispersion.site.site import Site, file_of
from dafw.plugins.models.dispersion.sources import sources
from dafw.views.site_places import DRONE_CLEARANCE, Ground, Places, Point, command_of


@dataclass(frozen=True)
class Preview:
    """A study on a site.

    Attributes:
        file: of the site, as ``model.site.file`` takes it.
        overrides: of the study, as ``dafw run`` takes them.
        composed: the configuration that they make.
        study: what is made of it.
        model: its model.
    """

    file: str
    overrides: tuple[str, ...]
    composed: Mapping[str, Any]
    study: Study
    model: AdvectionDiffusion

    @property
    def site(self) -> Site:
        """The site; raises SiteError."""
        return self.model.place

    @cached_property
    def ground(self) -> Ground:
        """Where something can be placed."""
        return Ground(self.site)

    @cached_property
    def changes(self) -> Changes:
        """What was done to the footprints of the file."""
        return changes_of(self.site, self.model.site)

    @cached_property
    def mesh(self) -> tuple[np.ndarray, np.ndarray]:
        """The nodes (nodes, 2) in m and the triangles (faces, 3); made if the cache does not hold the mesh."""
        variable = self.model.space.variables[0]
        assert variable.coordinates is not None and variable.triangles is not None
        return variable.coordinates, variable.triangles

    @property
    def _released(self) -> AdvectionDiffusion:
        """The model whose gas is really there: the truth, or where there is none that of the belief."""
        truth = self.study.truth
        return truth if isinstance(truth, AdvectionDiffusion) else self.model

    @property
    def places(self) -> Places:
        """Where the study puts the release, that of its truth if it has one, and the drones."""
        return Places(_point(self._released.release), tuple(_point(start) for start in self.study.start))

    @property
    def free_places(self) -> Places:
        """The same, moved to free ground near them where they cannot be."""
        configured, ground = self.places, self.ground
        release = ground.free_near(configured.release, self.model.release_radius)
        return Places(release, tuple(ground.free_near(drone, DRONE_CLEARANCE) for drone in configured.drones))

    @property
    def further(self) -> list[tuple[str, Point]]:
        """The sources beside the first, which stay where the options put them, with their names."""
        model = self._released
        found = sources(model.release, model.release_radius, model.source)
        return [(f"source {source.number}", source.place) for source in found[1:]]

    @property
    def winds(self) -> list[tuple[str, str, float, float]]:
        """The winds of truth and first guess: role, in words, speed in m/s, direction towards which it blows in rad."""
        found = []
        for role, words, model in (("truth", "truth", self.study.truth), ("belief", "first guess", self.study.model)):
            if isinstance(model, AdvectionDiffusion):
                found.append((role, words, *model.first_wind))
        return found

    @cached_property
    def attribution(self) -> str:
        """Whom the file of the site names as the authors of its data."""
        return attribution_of(file_of(self.model.site))

    def command(self, places: Places) -> str:
        """Return the command that runs the study with release and drones at these places."""
        return command_of(self.file, self.overrides, self.composed, places)

    def named(self, places: Places) -> list[tuple[str, Point]]:
        """Return every place with what is there, in words."""
        several = len(places.drones) > 1
        drones = [(f"drone {number}" if several else "drone", at) for number, at in enumerate(places.drones)]
        return [("release", places.release), *drones]

    def about(self, name: str, place: Point) -> str:
        """Return a line about a place: free and how far from walls, or why nothing can be there."""
        head = f"{name} at ({place[0]:g}, {place[1]:g}) m"
        if problem := self.ground.problem(place):
            return f"{head} {problem}: dafw run would refuse it"
        lon, lat = self.site.to_degrees(place)
        clearance = self.ground.clearance(place)
        walls = "" if clearance == float("inf") else f", {clearance:.0f} m from the nearest wall"
        return f"{head}{walls}, longitude {lon:.6f}, latitude {lat:.6f}"

    def size_lines(self) -> list[str]:
        """Return lines about the size of the mesh, and the memory and the time that a run takes."""
        nodes, triangles = self.mesh
        lines = [f"mesh of {len(nodes):,} nodes, {len(triangles):,} triangles"]
        ensemble = sum(self.study.wanted_memory().values())
        lines.append(
            f"memory: about {(bytes_of_process(len(nodes)) + ensemble) / 1e9:.1f} GB, with {self.study.members} members"
        )
        wind = getattr(self.model, "wind", None)
        if wind is not None and wind.solver != "newton":
            from dafw.plugins.models.dispersion.reduced_wind.choice import is_made

            if is_made(self.model.tagged_mesh, wind):
                lines.append("the winds of this site are in the cache: the first cycle begins within seconds")
            else:
                time = _in_words(seconds_of_basis(len(nodes), wind.basis))
                lines.append(f"the first run makes the winds of this site: about {time} on two cores, once")
        return lines


def preview_of(file: str, overrides: Sequence[str]) -> Preview:
    """Compose a study with a site; raises ConfigurationError if it is wrong or its model has no site."""
    if any(word.lstrip("+").startswith("model.site.file=") for word in overrides):
        raise ConfigurationError(f"site preview: the file is {file!r}, it cannot be an option, too")
    try:
        composed = study_part(compose([*overrides, quoted_override("model.site.file", file)]))
        study = study_from(composed)
    except OptionError:
        model = study_part(compose(overrides)).get("model", {})
        if "site" not in model:
            raise ConfigurationError(f"site preview: model '{model.get('name')}' has no site") from None
        raise
    if not isinstance(study.model, AdvectionDiffusion):
        raise ConfigurationError(f"site preview: {study.model.label} is none whose site can be drawn")
    return Preview(file, tuple(overrides), composed, study, study.model)


def _point(place: Sequence[float]) -> Point:
    return float(place[0]), float(place[1])


def _in_words(seconds: float) -> str:
    """Return a time, in s, as people say it."""
    for unit, name, longest in ((1.0, "s", 90.0), (60.0, "minutes", 5400.0)):
        if seconds < longest:
            return f"{seconds / unit:.0f} {name}"
    return f"{seconds / 3600.0:.0f} hours"
