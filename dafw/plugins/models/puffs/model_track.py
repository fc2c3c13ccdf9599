"""Model ``puffs_track``: what a slow sensor that is carried about, by a drone say, reads of a steady leak.

It is the leak of the model ``puffs`` (leak.py). The state has ``mean``, what the sensor showed on average in the step,
in ppm above the air around, ``shown``, what it shows at the step's end, and the unknown numbers, of which
``response_time`` T is one more: the sensor shows z where it meets c, ::

    dz/dt = (c - z) / T

c is computed at some moments of a step (point_levels.py), at the place and the height at which the sensor was then
(track.py), and taken as constant around each. At t = 0 the sensor shows no gas.

This module is imported with its options, so it must be light.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dafw.core.domain import Domain
from dafw.core.options import option
from dafw.core.rng import MemberStreams
from dafw.core.space import NONNEGATIVE, POSITIVE, Array, Kind, StateSpace, Variable
from dafw.plugins.models.puffs.leak import PRIORS, UNKNOWN, Leak
from dafw.plugins.models.puffs.track import Track, TrackFile, read_track


@dataclass
class PuffsTrack(Leak):
    """What a moving sensor with a slow response reads of a leak of unknown place and rate in a measured wind."""

    unknown: ClassVar[Mapping[str, tuple[Kind, str]]] = {**UNKNOWN, "response_time": (POSITIVE, "s")}
    usual: ClassVar[Mapping[str, Mapping[str, Any]]] = {
        **PRIORS,
        "response_time": {"name": "lognormal", "mean": 10.0, "sd": 0.5},
    }

    track: TrackFile = option(TrackFile, "where the sensor was")

    @property
    def input_files(self) -> Sequence[Path]:
        """The files with the wind and with the track."""
        from dafw.plugins.readings.files.any_file import paths_of

        return [*super().input_files, *paths_of(self.track)]

    @property
    def named(self) -> str:
        """The model's name in errors about its options."""
        return "model 'puffs_track'"

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return a flight across a steady wind."""
        track = {"points": [[0.0, 0.0, 0.0, 2.0], [600.0, 100.0, 20.0, 2.0]]}
        quick = {"wind": {"steady": [2.0, 1.0, 0.8, 0.3]}, "moments": 2, "oldest": 60.0}
        return {"track": track, "area": [-50.0, 0.0, 50.0, 100.0], **quick}

    def __post_init__(self) -> None:
        super().__post_init__()
        read = [
            Variable("mean", 1, NONNEGATIVE, "ppm", None, "what the sensor showed on average, above background"),
            Variable("shown", 1, NONNEGATIVE, "ppm", None, "what the sensor shows, above background"),
        ]
        self.space = StateSpace([*read, *self.unknown_variables()])
        low_x, low_y, high_x, high_y = self.area
        self.domain = Domain((low_x, low_y, high_x, high_y), landmarks=self.release_mark())

    @cached_property
    def flown(self) -> Track:
        """The sensor's track; raises ReadingsError."""
        return self._shared.once(("track", repr(self.track)), lambda: read_track(self.track, self.named))

    def require_available(self) -> None:
        """Read the wind and the track; raises ReadingsError if one cannot be read."""
        super().require_available()
        _ = self.flown  # reading it is all that is wanted

    def notes(self) -> list[str]:
        """Return what the wind record and the track hold."""
        time, places = self.flown.time, self.flown.places
        low, high = places.min(axis=0), places.max(axis=0)
        return [
            *super().notes(),
            f"{self.label}: a track of t = {time[0]:g} to {time[-1]:g} s, x = {low[0]:.0f} to {high[0]:.0f} m, "
            f"y = {low[1]:.0f} to {high[1]:.0f} m, {low[2]:.1f} to {high[2]:.1f} m above the ground",
        ]

    def step(self, members: Array, t: float, rng: MemberStreams) -> Array:
        """Return the members (N, n) at t + dt."""
        from dafw.plugins.models.puffs.point_levels import point_levels

        ages, lengths = self._ages
        carried, turbulence = self._inputs(t)
        places, rate, shapes, (response,) = self._numbers(members)
        met = point_levels(
            places,
            shapes,
            carried,
            turbulence,
            ages,
            lengths,
            self.flown.at(self._moments(t)),
            self.mixing_height,
        )
        met *= self.air.ppm_per_gram * rate[:, np.newaxis]
        kept = np.exp(-self.dt / (self.moments * response))
        shown, total = members[:, 1], np.zeros(len(members))
        for moment in range(self.moments):
            shown = met[:, moment] + kept * (shown - met[:, moment])
            total += shown
        stepped = members.copy()
        stepped[:, 0], stepped[:, 1] = total / self.moments, shown
        return stepped
