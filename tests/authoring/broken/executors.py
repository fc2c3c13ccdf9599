"""Executors with one fault each. They step members in this process, in two batches, when the result is fetched."""

from __future__ import annotations

import subprocess
import sys
from collections import deque
from dataclasses import dataclass, field, replace
from typing import ClassVar

from broken.registry import breaks
from dafw import ComputationError, DafwError, Executor, step_members


class Patient(Executor):
    def width(self):
        return 2

    def stepped(self, model, batches):
        return [step_members(model, batch) for batch in batches]

    def begin(self, model, batches):
        return lambda: self.stepped(model, batches)


@breaks("same_bits")
class LastFirst(Patient):
    """Returns batches of equal length in the wrong order."""

    def stepped(self, model, batches):
        right = super().stepped(model, batches)
        return right[::-1] if len({len(batch.members) for batch in batches}) == 1 else right


@breaks("same_bits")
class ForgetsTheMemory(Patient):
    def stepped(self, model, batches):
        begun = [replace(batch, memory=model.initial_memory(batch.members)) for batch in batches]
        return super().stepped(model, begun if sum(len(batch.members) for batch in batches) == 16 else batches)


@breaks("several_steps")
class KeepsTheLast(Patient):
    def stepped(self, model, batches):
        return super().stepped(model, [replace(batch, keep=False) for batch in batches])


@breaks("several_at_once")
@dataclass
class FirstComeFirstServed(Patient):
    """Returns the oldest result, whichever is fetched."""

    open: deque = field(default_factory=deque)

    def begin(self, model, batches):
        self.open.append(batches)
        return lambda: self.stepped(model, self.open.popleft())


@breaks("errors")
class LosesTheName(Patient):
    def stepped(self, model, batches):
        try:
            return super().stepped(model, batches)
        except DafwError as error:
            raise ComputationError(f"a worker failed: {error}") from error


@breaks("errors")
class NumbersWithinTheBatch(Patient):
    """Names a member by its number in the batch, not in the ensemble."""

    def stepped(self, model, batches):
        return super().stepped(model, [replace(batch, first=0) for batch in batches])


@breaks("close")
class LeavesAProcess(Patient):
    started: ClassVar[list] = []

    def start(self, model, config):
        self.started.append(subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]))

    def close(self):
        """Do nothing."""
