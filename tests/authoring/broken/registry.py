"""The broken plugins, by the check that must find them."""

from __future__ import annotations

from collections import defaultdict

BROKEN: dict[tuple[str, str], list[type]] = defaultdict(list)


def breaks(check: str):
    """Register the decorated plugin as one that this check, and no other, finds."""

    def register(cls: type) -> type:
        BROKEN[cls.kind, check].append(cls)
        return cls

    return register
