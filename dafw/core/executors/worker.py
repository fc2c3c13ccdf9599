"""The code that runs in a worker of an executor: it builds the model once and steps batches.

A worker builds its model from the configuration alone. It keeps no result: each batch brings all that a step needs.
"""

from __future__ import annotations

import pickle
import signal
import threading
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from dafw.core.ensemble import freeze
from dafw.core.executors import Executor
from dafw.core.executors.batches import Batch, Stepped, step_members
from dafw.core.interfaces.model import Model
from dafw.core.workers import Outcome, outcome

_MODELS: dict[bytes, Model] = {}
"""The model of this process, by its configuration; only the last one is kept."""
_ONE_AT_A_TIME = threading.Lock()  # a dask worker may have several threads, but the solvers are not thread-safe


def step_batch(config: Mapping[str, Any], batch: Batch) -> Outcome:
    """Step a batch with the model of a configuration; the value is a Stepped."""
    with _ONE_AT_A_TIME:
        return outcome(f"model '{config.get('name')}'", partial(_stepped, config, batch))


def _stepped(config: Mapping[str, Any], batch: Batch) -> Stepped:
    # Read-only, as they are in the main process, so that a model that changes its inputs fails here too.
    return step_members(built(config), replace(batch, members=freeze(batch.members)))


def built(config: Mapping[str, Any]) -> Model:
    """Return this process's model, which is made on the first call; raises a DafwError."""
    from threadpoolctl import threadpool_limits

    from dafw.core.registry import registry

    key = pickle.dumps(config)
    if key not in _MODELS:
        _MODELS.clear()
        model: Model = registry().create("model", config)
        _ = model.space  # makes the mesh, if there is one, now and not in the first step
        _MODELS[key] = model
        # For the life of the process. Libraries loaded later read the same limit from the environment.
        threadpool_limits(limits=1)
    return _MODELS[key]


def dask_setup(worker: object) -> None:
    """Prepare a worker of a dask cluster of our own: Ctrl-C is for the main process alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def build_ahead(config: Mapping[str, Any]) -> None:
    """Build the model before the first step. Errors are ignored here: the first step raises them again."""
    outcome("", partial(built, config))


def needs_registered(executor: Executor, model: Model) -> str:
    """Return the error message for a model that workers cannot make, because it is not registered."""
    return (
        f"{executor.label} makes the model anew in each worker: expected one that a package registers, "
        f"got {model.label}, which was made in Python; use the executor 'serial'"
    )
