"""A live run rehearses a cycle before its clock starts, so that its first readings need not wait.

The first cycle of a process loads libraries, and compiles what it computes with: that takes seconds, in which readings
pile up. So a cycle is made with a member of the first guess as the truth, and dropped. Nothing of it enters the run:
what a cycle computes depends on its state alone.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np

from dafw.core.cycle import Parts, State, advance
from dafw.core.errors import DafwError
from dafw.core.interfaces import Readings
from dafw.core.interfaces.readings import Request
from dafw.core.observation import Observation

log = logging.getLogger("dafw")
ROLE = "rehearsal"
"""The role of the random streams of its truth."""


class _Rehearsed(Readings):
    """A source that reads a truth as another source might."""

    needs_truth = True

    def __init__(self, source: Readings) -> None:
        self._source = source

    def take(self, request: Request, rng: np.random.Generator) -> Sequence[Observation]:
        """Return what might come."""
        return self._source.rehearsal(request)


def rehearse(parts: Parts, state: State) -> None:
    """Make the first cycle once, from the state at the start of a run, and drop it; an error is logged."""
    begun = perf_counter()
    try:
        truth = parts.model.first_guess(1, parts.streams.members(ROLE, 0))
        alone = replace(parts, readings=_Rehearsed(parts.readings), truth=parts.model, truth_view=None)
        advance(alone, replace(state, truth=truth, readings_memory=None))
    except DafwError as error:
        log.warning("the first cycle could not be rehearsed: %s", error)
        return
    log.info("the first cycle was rehearsed in %.1f s", perf_counter() - begun)
