"""What a filter that wraps another remembers for it: the other's memory, and the model's memory of its members."""

from __future__ import annotations

from dafw.core.ensemble import Memory

BASE, MODEL = "base ", "model "
"""Prefixes of the names of these arrays in the memory."""


def part_of(memory: Memory | None, prefix: str) -> Memory | None:
    """Return the arrays whose names have a prefix, without it; None if there are none."""
    if memory is None:
        return None
    return {name.removeprefix(prefix): memory[name] for name in memory if name.startswith(prefix)} or None
