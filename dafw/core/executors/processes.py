"""Executor ``processes``: long-lived worker processes of this machine, each with its own model and solvers.

A worker is sent the model's configuration and the batches, nothing else. It steps the batches in the order in which
they were sent. An ``_Order`` collects the results of one call of ``begin``, so that several can be under way at once.
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
    """The batches of one call of ``begin``, and the results received so far by batch number."""

    batches: Sequence[Batch]
    outcomes: dict[int, Outcome] = field(default_factory=dict)
    lost: int = 0
    error: ComputationError | None = None


@dataclass(eq=False)
class _Place:
    """A worker, and the batches that were sent to it and are not finished, in the order of sending."""

    worker: Worker
    waiting: deque[tuple[_Order, int]] = field(default_factory=deque)


@dataclass
class Processes(Executor):
    """Worker processes of this machine."""

    workers: int | None = option(None, "number of worker processes; null: one for each core", minimum=1)
    retries: int = option(2, "number of lost workers that are replaced in one step; one more ends the run", minimum=0)

    _pool: list[_Place] = field(default_factory=list, init=False, repr=False)
    _config: Mapping[str, Any] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return two workers, however many cores there are."""
        return {"workers": 2}

    def start(self, model: Model, config: Mapping[str, Any] | None) -> None:
        """Start the workers; they build their models while the main process continues."""
        self.close()
        if config is None:
            raise ConfigurationError(needs_registered(self, model))
        # Start them first: they load their libraries while this process determines the model's pinned options.
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
        """Return how many copies of the members the workers on this machine hold."""
        return 3

    def begin(self, model: Model, batches: Sequence[Batch]) -> Callable[[], Sequence[Stepped]]:
        """Send a batch to each worker; return a function that waits for all of them."""
        if not self._pool:
            raise ConfigurationError(f"{self.label} was not started: call its start(model, config) first")
        order = _Order(batches)
        # The least busy workers come first. Equally busy ones keep their order, so that the same members go to the
        # same worker each time and find their cached matrices there.
        places = sorted(self._pool, key=lambda place: len(place.waiting))
        for number, batch in enumerate(batches):
            place = places[number % len(places)]
            place.waiting.append((order, number))
            place.worker.ask(step_batch, self._config, batch)
        return partial(self._collect, order)

    def _collect(self, order: _Order) -> list[Stepped]:
        while order.error is None and len(order.outcomes) < len(order.batches):
            owing = [place for place in self._pool if place.waiting]
            ready = wait([place.worker.connection for place in owing])
            for place in [place for place in owing if place.worker.connection in ready]:
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
        """Replace a lost worker and send its unfinished batches to the new one; fail an order that loses too many."""
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
