"""Readings: the source of the measured values that a filter is given."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from dafw.core.domain import Domain
from dafw.core.ensemble import Ensemble, Memory
from dafw.core.errors import ConfigurationError, ContractError
from dafw.core.observation import Observation, ObservationOperator
from dafw.core.plugin import Plugin
from dafw.core.space import Array, StateSpace

FORGIVEN = 1e-6
"""Tolerance of reading times as a fraction of the time step: times of cycles are sums of rounded steps."""


@dataclass(frozen=True, eq=False)
class Request:
    """What a source is asked for: all readings that arrived after ``start`` and by ``end`` (s), late ones included.

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

    def arrived(self, times: Array) -> NDArray[np.bool_]:
        """Return which of the readings that arrive at ``times`` (R,), in s, do so in this cycle.

        The first cycle includes earlier ones. Times may be rounded: a reading of this cycle may be later than ``end``.
        """
        slack = FORGIVEN * (self.end - self.start)
        opened = -np.inf if self.cycle == 0 else self.start + slack
        return (times > opened) & (times <= self.end + slack)


@dataclass(frozen=True, eq=False)
class Taken:
    """What a source with a memory returns: the observations, what to remember, and sentences for the log.

    ``left_out`` counts readings that the source had and cannot give, by reason; a run warns of them and counts them.
    ``vehicles`` says by number where vehicles are at the end of the cycle, (2,) in metres; those that it does not name
    are where they were before. None: the source does not know, and vehicles are where they were sent.
    """

    observations: Sequence[Observation]
    memory: Memory | None = None
    notes: tuple[str, ...] = field(default=())
    left_out: Mapping[str, int] = field(default_factory=dict)
    vehicles: Mapping[int, Array] | None = None


class Readings(Plugin):
    """A source of readings: a truth, a file, an instrument.

    Each observation has its own time. Readings taken after ``start`` and up to ``end`` belong to the present cycle;
    older ones are late. A source with ``needs_truth = True`` is given the truth. One with ``is_live = True`` waits for
    readings that are still to come, and raises NoMoreReadingsError when there will be none.

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
    is_live: ClassVar[bool] = False
    journal: ClassVar[str] = ""
    """Of a live source: the file in the folder of a run in which it keeps what came, and from which it gives that again
    to a run that goes on. A live source without one can be run, but its runs cannot go on."""
    follows_wall: bool = False
    """Whether the cycles of a live source end at their time by the wall's clock."""
    reads_standard_input: bool = False
    word: ClassVar[str] = "row"
    """What one of the source's entries is called in messages."""

    @classmethod
    def check_space(cls) -> StateSpace | None:
        """Return a small state space that the checks use; None: their own, with ``concentration`` and a wind."""
        return None

    def take(self, request: Request, rng: np.random.Generator) -> Sequence[Observation]:
        """Return the readings that arrived in the time of the request; an empty sequence if there were none."""
        raise NotImplementedError(f"{self.label} must define take(request, rng)")

    def suit(self, space: StateSpace, domain: Domain | None, dt: float) -> None:
        """Raise ConfigurationError if the options do not fit a state space, its domain and a time step (s)."""

    def notes(self) -> list[str]:
        """Return sentences for the log about where the readings come from; called after ``suit``."""
        return []

    def begin(self, folder: Path, asked_to_stop: Callable[[], bool]) -> None:
        """Prepare for a run into ``folder``, before its first cycle; a live source connects to its feed.

        A source that waits calls ``asked_to_stop`` now and then, and raises KeyboardInterrupt if it returns True.
        """

    def end(self) -> None:
        """Release what ``begin`` opened; called when a run ends, however it does."""

    @property
    def advises(self) -> Sequence[str]:
        """Where advice goes beside the places that a study names; ``mqtt`` stands for ``publisher``."""
        return ()

    def publisher(self) -> Callable[[bytes], None]:
        """Return what sends a line of advice to the place that is called ``mqtt``; raises ConfigurationError."""
        raise ConfigurationError(f"advice=[mqtt] goes with readings that come through a broker, got {self.label}")

    def zero_of_run(self, memory: Memory | None) -> float | None:
        """Return the Unix time of t = 0, after which advice has dates; None where it is not known.

        ``memory`` is that of the source, as of the last cycle.
        """
        return None

    def rehearsal(self, request: Request) -> Sequence[Observation]:
        """Return readings as they might come to a live source, for a cycle that a run rehearses; none if it cannot.

        ``request.truth`` is a state that the model might have, of which these are readings.
        """
        return ()

    def cycles_covered(self, dt: float) -> int | None:
        """Return the number of cycles of ``dt`` seconds until all readings are known; None: the source has no end.

        It is the length of a study with ``cycles=null``.
        """
        return None

    def known_cycles(self) -> int:
        """Return how many first cycles the journal has all readings of; asked after ``begin``.

        Nobody can obey advice for them any more.
        """
        return 0

    def settle(self) -> None:
        """Write the journal to the disk: a checkpoint is about to rely on it. Raises OSError, RecordError."""

    def again(self, folder: Path) -> Self:
        """Return the source that gives another run what this one gave to the complete run in ``folder``."""
        return self

    def initial_memory(self) -> Memory | None:
        """Return the memory that the first request is given."""
        return None

    def take_with_memory(self, request: Request, memory: Memory | None, rng: np.random.Generator) -> Taken:
        """Return the readings of a source that remembers."""
        return Taken(self.take(request, rng))

    def collect(self, request: Request, memory: Memory | None, rng: np.random.Generator) -> Taken:
        """Ask for readings and check that they are finite numbers and not from the future; raises ContractError.

        Raises ConfigurationError for a reading of an angle: nothing that compares it with predictions knows that it
        wraps.
        """
        taken = self.take_with_memory(request, memory, rng)
        if not isinstance(taken, Taken):
            raise ContractError(f"{self.label}: expected observations, got {taken!r}")
        latest = request.end + 1e-9 * max(1.0, abs(request.end))
        for observation in taken.observations:
            if not isinstance(observation, Observation):
                raise ContractError(f"{self.label}: expected observations, got {taken!r}")
            self.checked(observation.values, observation.values.shape, "readings")
            if angle := request.space.angle_among(observation.operator.entries):
                raise ConfigurationError(f"{self.label}: '{angle}' is an angle: expected readings of another variable")
            if observation.time > latest:
                raise ContractError(
                    f"{self.label}: a reading of t = {observation.time:g} s was given in the cycle that ends at "
                    f"{request.end:g} s"
                )
        return taken
