"""Executor ``dask``: workers of a dask cluster, on this machine or at a scheduler's address.

Every worker process keeps the model in a module variable, not in a dask actor. So nothing is lost with a worker: dask
runs its batch again on another.
"""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from dafw.core.errors import ComputationError, ConfigurationError
from dafw.core.executors import Executor
from dafw.core.executors.batches import Batch, Stepped
from dafw.core.executors.worker import needs_registered, step_batch
from dafw.core.interfaces.model import Model
from dafw.core.options import merged, option
from dafw.core.workers import Outcome, cores

log = logging.getLogger("dafw")


@dataclass
class Dask(Executor):
    """Workers of a new cluster on this machine, or of the scheduler at an address."""

    address: str | None = option(None, "scheduler, such as tcp://10.0.0.1:8786; null: a cluster on this machine")
    workers: int | None = option(
        None, "number of workers; null: one for each core, or all that the scheduler has", minimum=1
    )
    retries: int = option(
        2, "how often a batch is repeated after its worker was lost; only without an address", minimum=0
    )
    wait: float = option(60.0, "how long to wait for the workers, in seconds", above=0.0)

    _client: Any = field(default=None, init=False, repr=False)
    _cluster: Any = field(default=None, init=False, repr=False)
    _config: Mapping[str, Any] = field(default_factory=dict, init=False, repr=False)
    _batches: int = field(default=0, init=False, repr=False)

    @classmethod
    def check_options(cls) -> Mapping[str, Any]:
        """Return two workers, however many cores there are."""
        return {"workers": 2}

    def __post_init__(self) -> None:
        if importlib.util.find_spec("distributed") is None:
            raise ConfigurationError(f"{self.label} needs the package distributed: install dafw[dask]")

    def start(self, model: Model, config: Mapping[str, Any] | None) -> None:
        """Start the cluster or connect to it; raises ConfigurationError if the scheduler does not answer."""
        import dask
        from distributed import Client, LocalCluster

        self.close()
        if config is None:
            raise ConfigurationError(needs_registered(self, model))
        self._config = merged(config, model.pinned_options())
        dask.config.set({"distributed.scheduler.allowed-failures": self.retries})
        count = self.workers or (1 if self.address else cores())
        try:
            if self.address is None:
                self._cluster = LocalCluster(
                    n_workers=count,
                    threads_per_worker=1,
                    host="127.0.0.1",
                    # dask opens a port even without a dashboard. Any free one, so that several runs do not collide.
                    dashboard_address="127.0.0.1:0",
                    scheduler_kwargs={"dashboard": False},
                    memory_limit=0,
                    preload=["dafw.core.executors.worker"],
                    silence_logs=logging.CRITICAL,
                )
                self._client = Client(self._cluster, set_as_default=False)
            else:
                self._client = Client(self.address, timeout=self.wait, set_as_default=False)
            self._client.wait_for_workers(count, timeout=self.wait)
        except (OSError, TimeoutError, ValueError) as error:
            self.close()
            place = self.address or "this machine"
            raise ConfigurationError(f"{self.label}: no {count} workers at {place}: {error}") from error
        self._batches = self.workers or len(self._addresses())
        log.info("%s: %d workers at %s", self.label, self._batches, self._client.scheduler.address)

    def _addresses(self) -> list[str]:
        return sorted(self._client.scheduler_info(n_workers=-1)["workers"])

    def width(self) -> int:
        """Return the number of workers."""
        return max(1, self._batches)

    def copies(self) -> int:
        """Return how many copies of the members the workers on this machine hold."""
        return 0 if self.address else 3

    def begin(self, model: Model, batches: Sequence[Batch]) -> Callable[[], Sequence[Stepped]]:
        """Hand the batches to the scheduler; return a function that waits for all of them."""
        if self._client is None:
            raise ConfigurationError(f"{self.label} was not started: call its start(model, config) first")
        import dask

        there = self._addresses()
        futures = []
        # Prefer the worker that had the batch before, if it is free: it may still hold the matrices of these members.
        with dask.config.set({"distributed.admin.large-graph-warning-threshold": "100 GB"}):
            for number, batch in enumerate(batches):
                where = {"workers": [there[number % len(there)]], "allow_other_workers": True} if there else {}
                futures.append(self._client.submit(step_batch, self._config, batch, pure=False, **where))
        return partial(self._collect, batches, futures)

    def _collect(self, batches: Sequence[Batch], futures: Sequence[Any]) -> list[Stepped]:
        return [self._outcome(batch, future).get() for batch, future in zip(batches, futures, strict=True)]

    def _outcome(self, batch: Batch, future: Any) -> Outcome:
        from concurrent.futures import CancelledError

        from distributed import KilledWorker

        try:
            outcome: Outcome = future.result()
        except KilledWorker as error:
            raise ComputationError(
                f"{self.label}: one worker after the other was lost while it stepped {batch.title}"
            ) from error
        except (OSError, CancelledError) as error:
            raise ComputationError(f"{self.label}: the scheduler was lost in a step: {error}") from error
        return outcome

    def close(self) -> None:
        """Disconnect from the cluster; end it if this executor started it."""
        client, cluster, self._client, self._cluster = self._client, self._cluster, None, None
        for thing in (client, cluster):
            if thing is not None:
                thing.close()
