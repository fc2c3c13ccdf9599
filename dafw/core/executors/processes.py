"""Executor ``processes``: long-lived worker processes of this machine, each with its own model and solvers.

A worker is told the model's configuration and the batches, nothing else.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import wait
from typing import Any

from dafw.core.ensemble import Memory, Step
from dafw.core.errors import ComputationError, ConfigurationError
from dafw.core.executors import Executor
from dafw.core.executors.batches import Batch, join, split
from dafw.core.executors.worker import build_ahead, step_batch
from dafw.core.interfaces import Model
from dafw.core.options import merged, option
from dafw.core.rng import MemberStreams
from dafw.core.space import Array
from dafw.core.workers import Outcome, Worker, cores, dismiss

log = logging.getLogger("dafw")


@dataclass
class Processes(Executor):
    """Worker processes of this machine."""

    name = "processes"

    workers: int | None = option(None, "number of worker processes; null: one for each core", minimum=1)
    retries: int = option(2, "how often in one step a worker that was lost is replaced", minimum=0)

    _pool: list[Worker] = field(default_factory=list, init=False, repr=False)
    _config: Mapping[str, Any] = field(default_factory=dict, init=False, repr=False)

    def start(self, model: Model, config: Mapping[str, Any]) -> None:
        """Start the workers; they build their models while the main process goes on."""
        self.close()
        # Started first: they load their libraries while this process finds out what they must agree on.
        self._pool = [Worker() for _ in range(self.workers or cores())]
        self._config = merged(config, model.pinned_options())
        for worker in self._pool:
            worker.tell(build_ahead, self._config)
        log.info("%s: %d workers, processes %s", self.label, len(self._pool), [w.process.pid for w in self._pool])

    def submit(
        self, model: Model, members: Array, memory: Memory | None, t: float, rng: MemberStreams
    ) -> Callable[[], Step]:
        """Hand a batch to each worker; what comes back waits for all of them."""
        if not self._pool:
            raise ConfigurationError(f"{self.label} was not started: call its start(model, config) first")
        for number, worker in enumerate(self._pool):
            if worker.busy:  # with a step that nobody waited for
                worker.end()
                self._pool[number] = Worker()
        batches = split(model, members, memory, t, rng, len(self._pool))
        for worker, batch in zip(self._pool, batches, strict=False):
            worker.ask(step_batch, self._config, batch)
        return partial(self._collect, model, batches)

    def _collect(self, model: Model, batches: Sequence[Batch]) -> Step:
        outcomes: dict[int, Outcome] = {}
        lost = 0
        while len(outcomes) < len(batches):
            open_ones = {self._pool[n].connection: n for n in range(len(batches)) if n not in outcomes}
            for connection in wait(list(open_ones)):
                number = open_ones[connection]  # type: ignore[index]  # wait gives back what it was given
                outcome = self._pool[number].receive()
                if outcome is None:
                    lost += 1
                    self._replace(number, batches[number], lost)
                else:
                    outcomes[number] = outcome
        return join(model, batches, [outcomes[number].get() for number in range(len(batches))])

    def _replace(self, number: int, batch: Batch, lost: int) -> None:
        """Put a new worker where one was lost, and have it do the batch; raises ComputationError at the last."""
        what = f"{self.label}: worker {number} {self._pool[number].lost()} while it stepped {batch.title}"
        if lost > self.retries:
            raise ComputationError(f"{what}; {lost} were lost in this step, at most {self.retries} are replaced")
        log.warning("%s at t = %g s; they are computed again", what, batch.t)
        self._pool[number] = Worker()
        self._pool[number].ask(step_batch, self._config, batch)

    def close(self) -> None:
        """End all workers; returns when they are gone."""
        pool, self._pool = self._pool, []
        dismiss(pool)
