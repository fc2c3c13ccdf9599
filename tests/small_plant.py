"""A small twin among six tanks, whose runs take a moment."""

from __future__ import annotations

from typing import Any

from dafw import Study
from dafw.plugins.filters.etkf import ETKF
from dafw.plugins.models.dispersion.model import AdvectionDiffusion
from dafw.plugins.observers.drone import Drone
from dafw.plugins.policies.enie2d import EnIE2D


def small_plant(start: list[list[float]], dt: float | None = None, **more: Any) -> Study:
    """Return the study of drones from ``start``, steered by a belief about an uncertain wind; ``more`` of its parts."""
    options = {**AdvectionDiffusion.check_options(), **({} if dt is None else {"dt": dt})}
    parts = {
        "model": AdvectionDiffusion.from_options(**options),
        "truth": AdvectionDiffusion.from_options(**{**options, "certain": True}),
        "observer": Drone(noise_sd=0.01),
        "policy": EnIE2D(),
        "filter": ETKF(),
        "start": start,
        "members": 6,
        "cycles": 6,
        "seed": 1000,
    }
    return Study(**(parts | more))
