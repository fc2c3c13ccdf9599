"""How often a run writes a checkpoint."""

from __future__ import annotations

from dataclasses import dataclass

from dafw.core.options import option

SHARE = 0.01
"""The most of a run's time that checkpoints may take where their distance is given in seconds."""


@dataclass
class CheckpointPlan:
    """The checkpoints of a run. Without ``every`` and ``cycles`` there are none."""

    every: float | None = option(
        30.0,
        "seconds from one checkpoint to the next, more if a checkpoint takes long: at most 1 % of the time goes into "
        "them; null: no checkpoints",
        above=0.0,
    )
    cycles: int | None = option(
        None, "write a checkpoint after every so many cycles, however long they take; null: by the clock", minimum=1
    )

    @property
    def wanted(self) -> bool:
        """Whether there are checkpoints at all."""
        return self.every is not None or self.cycles is not None

    def is_due(self, cycles: int, seconds: float, cost: float) -> bool:
        """Return whether a checkpoint is due.

        Args:
            cycles: how many cycles were done since the last checkpoint, or since the run began.
            seconds: how long they took.
            cost: the seconds that the last checkpoint took.
        """
        if self.cycles is not None:
            return cycles >= self.cycles
        return self.every is not None and seconds >= max(self.every, cost / SHARE)
