"""Model ``puffs``: what lines read of a steady leak, of which nothing is known, in a wind that was measured.

The state has no field. It has ``path_mean``, the mean mole fraction along every line above that of the air around,
averaged over the step, and the unknown numbers: place and rate of the leak; by how much the wind there is turned and
faster than the measured one; the widths of a fresh puff and how fast it grows (leak.py, path_means.py).

The equation is linear in the rate, and the puffs of every place are carried by the same wind. So a step of a member
costs a tenth of a millisecond, and a filter may run thousands of them again.

This module is imported with its options, so it must be light.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dafw.core.domain import Domain
from dafw.core.errors import ConfigurationError
from dafw.core.options import REQUIRED, option
from dafw.core.rng import MemberStreams
from dafw.core.space import NONNEGATIVE, Array, StateSpace, Variable
from dafw.plugins.models.puffs.leak import Leak
from dafw.plugins.observers.path import ends_of

SIDES = ("from", "to")
"""Landmarks of a path NAME are its ends, ``NAME from`` and ``NAME to``."""


@dataclass(kw_only=True)  # an option that must be given follows the base's, which have defaults
class Puffs(Leak):
    """What open paths read of a leak of unknown place and rate in a measured wind."""

    paths: dict[str, Any] = option(REQUIRED, "by name: the two ends of a path, [[x, y], [x, y]] in metres")
    path_height: float = option(1.5, "height of the paths above the ground, m", minimum=0.0)

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return two paths in a steady wind."""
        lines = {"a": [[0.0, 0.0], [0.0, 100.0]], "b": [[0.0, 100.0], [100.0, 100.0]]}
        quick = {"wind": {"steady": [2.0, 1.0, 0.8, 0.3]}, "moments": 1, "oldest": 60.0}
        return {"paths": lines, "area": [-50.0, 0.0, 50.0, 100.0], **quick}

    def __post_init__(self) -> None:
        super().__post_init__()
        ends = ends_of(self.paths, "model 'puffs'")
        if not ends:
            raise ConfigurationError("model 'puffs': paths must name at least one path")
        first, last = np.array(list(ends.values())).transpose(1, 0, 2)
        length = np.linalg.norm(last - first, axis=1, keepdims=True)
        if not length.all():
            raise ConfigurationError("model 'puffs': a path must not end where it starts")
        self._lines = np.hstack([first, (last - first) / length, length])
        middles = 0.5 * (first + last)
        self.space = StateSpace(
            [
                Variable("path_mean", len(ends), NONNEGATIVE, "ppm", middles, "mean along a path, above background"),
                *self.unknown_variables(),
            ]
        )
        low_x, low_y, high_x, high_y = self.area
        corners = np.array([[low_x, low_y], [high_x, high_y], *first, *last])
        bounds = (*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())
        marks = {
            f"{name} {side}": (x, y)
            for name, line in ends.items()
            for side, (x, y) in zip(SIDES, line.tolist(), strict=True)
        }
        marks |= self.release_mark()
        self.domain = Domain((bounds[0], bounds[1], bounds[2], bounds[3]), landmarks=marks)

    def step(self, members: Array, t: float, rng: MemberStreams) -> Array:
        """Return the members (N, n) at t + dt: the path means of a leak that has always been there."""
        from dafw.plugins.models.puffs.path_means import path_means

        p = len(self._lines)
        ages, lengths = self._ages
        carried, turbulence = self._inputs(t)
        places, rate, shapes, _ = self._numbers(members)
        means = path_means(
            places,
            shapes,
            carried,
            turbulence,
            ages,
            lengths,
            self._lines,
            np.full(p, self.path_height),
            self.mixing_height,
        )
        stepped = members.copy()
        stepped[:, :p] = self.air.ppm_per_gram * rate[:, np.newaxis] * means
        return stepped
