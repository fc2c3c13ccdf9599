"""Readings that wait: what a filter with the option ``every`` remembers of cycles in which no analysis was due.

The cycle of the next analysis may have no readings itself. Without this mark in its memory, the filter would not be
called then.
"""

from __future__ import annotations

import numpy as np

from dafw.core.ensemble import Memory
from dafw.core.window import Window

WAITING = "waiting"
"""Name of the mark in the memory."""


def waits(memory: Memory | None) -> bool:
    """Return whether readings wait for the next analysis."""
    return memory is not None and WAITING in memory


def marked(memory: Memory | None, window: Window) -> Memory | None:
    """Return a memory for a cycle without an analysis: marked, if readings came in it, late ones too, or waited."""
    if window.observation.values.size or window.late or waits(window.memory):
        return {**(memory or {}), WAITING: np.array(True)}
    return memory


def unmarked(memory: Memory | None) -> Memory | None:
    """Return a memory without the mark; None if there is nothing else."""
    return None if memory is None else {name: memory[name] for name in memory if name != WAITING} or None
