"""When readings are due that are taken every so many seconds."""

from __future__ import annotations

from dafw.core.errors import ConfigurationError

# A tenth of a millisecond forgives times that are sums of rounded steps.
FORGIVEN = 1e-4


def is_due(t: float, every: float | None) -> bool:
    """Say whether t (seconds) is a multiple of ``every``; None: always."""
    return every is None or (t + FORGIVEN) % every < 2 * FORGIVEN


def require_steps(every: float | None, dt: float, label: str) -> None:
    """Raise ConfigurationError where ``every`` is no multiple of the time step: readings would be lost in silence."""
    if every is None:
        return
    steps = every / dt
    if steps < 1.0 - 1e-9 or abs(steps - round(steps)) > 1e-6 * steps:
        raise ConfigurationError(f"{label}: every = {every:g} s is no multiple of the time step, {dt:g} s")
