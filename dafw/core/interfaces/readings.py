"""Readings: where the numbers come from that a filter is told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from dafw.core.domain import Domain
from dafw.core.ensemble import Ensemble, Memory
from dafw.core.errors import ContractError
from dafw.core.observation import Observation, ObservationOperator
from dafw.core.plugin import Plugin
from dafw.core.space import StateSpace


@dataclass(frozen=True, eq=False)
class Request:
    """What a source is asked for: all that became known after ``start`` and by ``end`` (seconds), late readings too.

    ``operator`` is what the observer would read at ``end`` on the route that was flown. ``truth`` is the one member of
    the truth at ``end``, in the belief's ``space``; None in a study without a truth. ``cycle`` counts from 0.
    """

    cycle: int
    start: float
    end: float
    space: StateSpace
    domain: Domain | None
    operator: ObservationOperator
    truth: Ensemble | None = None


@dataclass(frozen=True, eq=False)
class Taken:
    """What a source with a memory returns: the observations, what to remember, and sentences for the log."""

    observations: Sequence[Observation]
    memory: Memory | None = None
    notes: tuple[str, ...] = field(default=())


class Readings(Plugin):
    """Where the numbers come from: from a truth, a file, an instrument.

    Each observation has its own time. What lies after ``start`` and up to ``end`` belongs to the cycle that asks; what
    is older came late. A source that says ``needs_truth = True`` is handed the truth.

    >>> class Constant(Readings):
    ...     def take(self, request, rng):
    ...         return [Observation(np.ones(request.operator.size), request.operator, request.end)]
    >>> space = StateSpace([Variable("level", 2)])
    >>> operator = Selection(indices=np.array([0]), covariance=np.array([0.01]))
    >>> Constant().collect(Request(0, 0.0, 1.0, space, None, operator), None, None).observations[0].values
    array([1.])
    """

    kind = "readings"
    needs_truth: ClassVar[bool] = False

    @classmethod
    def check_space(cls) -> StateSpace | None:
        """Return a small state space that the checks use; None: their own, with ``concentration`` and a wind."""
        return None

    def take(self, request: Request, rng: np.random.Generator) -> Sequence[Observation]:
        """Return the readings that became known in the time of the request, none where there are none."""
        raise NotImplementedError(f"{self.label} must define take(request, rng)")

    def suit(self, space: StateSpace, domain: Domain | None, dt: float) -> None:
        """Raise ConfigurationError where the options do not go with a state space, its places and a time step (s)."""

    def initial_memory(self) -> Memory | None:
        """Return what the first request must be told."""
        return None

    def take_with_memory(self, request: Request, memory: Memory | None, rng: np.random.Generator) -> Taken:
        """Return the readings of a source that remembers."""
        return Taken(self.take(request, rng))

    def collect(self, request: Request, memory: Memory | None, rng: np.random.Generator) -> Taken:
        """Ask for readings and check them: numbers, finite, none from the future; raises ContractError."""
        taken = self.take_with_memory(request, memory, rng)
        if not isinstance(taken, Taken) or not all(isinstance(one, Observation) for one in taken.observations):
            raise ContractError(f"{self.label}: expected observations, got {taken!r}")
        latest = request.end + 1e-9 * max(1.0, abs(request.end))
        for observation in taken.observations:
            self.checked(observation.values, observation.values.shape, "readings")
            if observation.time > latest:
                raise ContractError(
                    f"{self.label}: a reading of t = {observation.time:g} s was given in the cycle that ends at "
                    f"{request.end:g} s"
                )
        return taken
