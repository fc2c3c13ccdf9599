"""Tells in which steps readings are due that are taken at a fixed interval."""

from __future__ import annotations

from dafw.core.errors import ConfigurationError


def is_due(t: float, every: float | None, dt: float) -> bool:
    """Return whether readings taken at the interval ``every`` (s) are due in the step that begins at t; None: always.

    ``every`` is a multiple of the time step ``dt`` (see ``require_steps``). Whole steps are counted, because t may be a
    sum of many rounded steps. If dt is 0, as in a route made by hand, t itself must be a multiple of ``every``.
    """
    if every is None:
        return True
    step = dt or every * 1e-6
    return round(t / step) % round(every / step) == 0


def require_steps(every: float | None, dt: float, label: str) -> None:
    """Raise ConfigurationError if ``every`` is not a multiple of the time step: readings would be lost silently."""
    if every is None:
        return
    steps = every / dt
    if steps < 1.0 - 1e-9 or abs(steps - round(steps)) > min(1e-6 * steps, 1e-2):
        raise ConfigurationError(f"{label}: every = {every:g} s is no multiple of the time step, {dt:g} s")
