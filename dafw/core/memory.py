"""How much memory a study needs, asked before it begins instead of being ended by the system in the middle."""

from __future__ import annotations

from collections.abc import Mapping

import psutil  # type: ignore[import-untyped]

from dafw.core.errors import ConfigurationError


def require_memory(wanted: Mapping[str, float]) -> None:
    """Raise ConfigurationError where the bytes that are wanted, by what they are for, exceed what the machine has free.

    The most expensive thing is named.
    """
    total, free = sum(wanted.values()), psutil.virtual_memory().available
    if total > free:
        worst = max(wanted, key=lambda name: wanted[name])
        raise ConfigurationError(
            f"the study needs at least {total / 1e9:.3g} GB of memory, this machine has {free / 1e9:.3g} GB free; "
            f"{wanted[worst] / 1e9:.3g} GB of it for {worst}"
        )
