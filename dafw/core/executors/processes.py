"""Executor ``processes``: long-lived worker processes of this machine, each with its own model and solvers.

A worker is told the model's configuration and the batches, nothing else. It takes them in the order in which they were
handed over; a ``_Order`` is what one call of ``begin`` waits for, so that several can be under way at once.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import wait
from typing import Any

from dafw.core.errors import ComputationError, ConfigurationError
from dafw.core.executors import Executor
from dafw.core.executors.batches import Batch, Stepped
from dafw.core.executors.worker import build_ahead, needs_registered, step_batch
from dafw.core.interfaces.model import Model
from dafw.core.options import merged, option
from dafw.core.workers import Outcome, Worker, cores, dismiss

log = logging.getLogger("dafw")


@dataclass(eq=False)
class _Order:
    """The batches of one call of ``begin``, and what has come back of them by their number."""

    batches: Sequence[Batch]
    outcomes: dict[int, Outcome] = field(default_factory=dict)
    lost: int = 0
    error: ComputationError | None = None


@dataclass(eq=False)
class _Place:
    """A worker, and the batches that it was handed and has not given back, in that order."""

    worker: Worker
    waiting: deque[tuple[_Order, int]] = field(default_factory=deque)


@dataclass
class Processes(Executor):
    """Worker processes of this machine."""

    workers: int | None = option(None, "number of worker processes; null: one for each core", minimum=1)
    retries: int = option(2, "how often in one step a worker that was lost is replaced", minimum=0)

    _pool: list[_Place] = field(default_factory=list, init=False, repr=False)
    _config: Mapping[str, Any] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return two workers, however many cores there are."""
        return {"workers": 2}

    def start(self, model: Model, config: Mapping[str, Any] | None) -> None:
        """Start the workers; they build their models while the main process goes on."""
        self.close()
        if config is None:
            raise ConfigurationError(needs_registered(self, model))
        # Started first: they load their libraries while this process finds out what they must agree on.
        self._pool = [_Place(Worker()) for _ in range(self.workers or cores())]
        self._config = merged(config, model.pinned_options())
        for place in self._pool:
            place.worker.tell(build_ahead, self._config)
        pids = [place.worker.process.pid for place in self._pool]
        log.info("%s: %d workers, processes %s", self.label, len(self._pool), pids)

    def width(self) -> int:
        """Return the number of workers."""
        return max(1, len(self._pool))

    def copies(self) -> int:
        """Return how often the members are held in workers of this machine."""
        return 3

    def begin(self, model: Model, batches: Sequence[Batch]) -> Callable[[], Sequence[Stepped]]:
        """Hand a batch to each worker; what comes back waits for all of them."""
        if not self._pool:
            raise ConfigurationError(f"{self.label} was not started: call its start(model, config) first")
        order = _Order(batches)
        # Those with the least to do first; among equals in their order, so that a member meets its kept matrices.
        places = sorted(self._pool, key=lambda place: len(place.waiting))
        for number, batch in enumerate(batches):
            place = places[number % len(places)]
            place.waiting.append((order, number))
            place.worker.ask(step_batch, self._config, batch)
        return partial(self._collect, order)

    def _collect(self, order: _Order) -> list[Stepped]:
        while order.error is None and len(order.outcomes) < len(order.batches):
            owing = {place.worker.connection: place for place in self._pool if place.waiting}
            for connection in wait(list(owing)):
                place = owing[connection]  # type: ignore[index]  # wait gives back what it was given
                outcome = place.worker.receive()
                if outcome is None:
                    self._replace(place)
                else:
                    whose, number = place.waiting.popleft()
                    whose.outcomes[number] = outcome
                    place.worker.busy = bool(place.waiting)
        if order.error is not None:
            raise order.error
        return [order.outcomes[number].get() for number in range(len(order.batches))]

    def _replace(self, place: _Place) -> None:
        """Put a new worker where one was lost, and hand it all that waits; an order that loses too many has failed."""
        order, number = place.waiting[0]
        order.lost += 1
        batch = order.batches[number]
        where = self._pool.index(place)
        what = f"{self.label}: worker {where} {place.worker.lost()} while it stepped {batch.title}"
        place.worker = Worker()
        if order.lost > self.retries:
            order.error = ComputationError(
                f"{what}; {order.lost} were lost in this step, at most {self.retries} are replaced"
            )
            place.waiting = deque(entry for entry in place.waiting if entry[0] is not order)
        else:
            log.warning("%s at t = %g s; they are computed again", what, batch.t)
        for whose, waiting in place.waiting:
            place.worker.ask(step_batch, self._config, whose.batches[waiting])

    def close(self) -> None:
        """End all workers; returns when they are gone."""
        pool, self._pool = self._pool, []
        dismiss([place.worker for place in pool])
