"""Executor ``processes``: long-lived worker processes of this machine, each with its own model and solvers.

A worker is a fresh interpreter, never a fork: PETSc and its threads survive none. It is told the model's configuration
and the batches; closing its connection ends it, so that none outlives the main process, however that ends.
"""

from __future__ import annotations

import contextlib
import logging
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Pipe, wait
from typing import Any

from dafw.core.ensemble import Memory, Step
from dafw.core.errors import ComputationError, ConfigurationError
from dafw.core.executors import Executor
from dafw.core.executors.batches import Batch, cores, join, split
from dafw.core.executors.worker import Outcome
from dafw.core.interfaces import Model
from dafw.core.options import merged, option
from dafw.core.rng import MemberStreams
from dafw.core.space import Array

log = logging.getLogger("dafw")

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"), "1")
PATIENCE = 5.0
"""Seconds that an idle worker has to end by itself."""
PROGRAM = "import sys; sys.path[:] = {path!r}; from dafw.core.executors.worker import main; main({descriptor})"


class Worker:
    """One worker process and the connection to it."""

    def __init__(self) -> None:
        self.connection, theirs = Pipe()
        with theirs:
            # The same interpreter and path, but not the user's script once more; a group of its own, out of reach of
            # Ctrl-C; what models print must not get between a command's results.
            self.process = subprocess.Popen(
                [sys.executable, "-c", PROGRAM.format(path=sys.path, descriptor=theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=2,
                env={**os.environ, **ONE_THREAD},
                pass_fds=[theirs.fileno()],
                process_group=0,
            )
        self.busy = False

    def send(self, config: Mapping[str, Any], batch: Batch | None) -> None:
        """Hand over a batch, or the configuration alone; a worker that is gone shows when it is waited for."""
        self.busy = batch is not None
        with contextlib.suppress(OSError):
            self.connection.send((config, batch))

    def receive(self) -> Outcome | None:
        """Return the outcome of the batch; None where the worker ended instead."""
        try:
            outcome: Outcome = self.connection.recv()
        except (EOFError, OSError):
            return None
        self.busy = False
        return outcome

    def dismiss(self) -> None:
        """Tell the worker to end: at once where it is in a step that nobody waits for."""
        self.connection.close()
        if self.busy:
            self.process.kill()

    def end(self) -> int:
        """See the worker off; return its exit status, a signal's number negative."""
        self.dismiss()
        try:
            return self.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()


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
            worker.send(self._config, None)
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
            worker.send(self._config, batch)
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
        steps = []
        for number in range(len(batches)):
            outcomes[number].relog()
            if error := outcomes[number].error:
                raise error
            steps.append(outcomes[number].step)
        return join(model, batches, [step for step in steps if step is not None])

    def _replace(self, number: int, batch: Batch, lost: int) -> None:
        """Put a new worker where one was lost, and have it do the batch; raises ComputationError at the last."""
        gone = self._pool[number]
        status = gone.end()
        how = f"killed by signal {-status}" if status < 0 else f"ended with status {status}"
        what = f"{self.label}: worker {number} (process {gone.process.pid}) was {how} while it stepped {batch.title}"
        if lost > self.retries:
            raise ComputationError(f"{what}; {lost} were lost in this step, at most {self.retries} are replaced")
        log.warning("%s at t = %g s; they are computed again", what, batch.t)
        self._pool[number] = Worker()
        self._pool[number].send(self._config, batch)

    def close(self) -> None:
        """End all workers; returns when they are gone."""
        pool, self._pool = self._pool, []
        for worker in pool:
            worker.dismiss()
        for worker in pool:
            worker.end()
