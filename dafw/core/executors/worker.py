"""What runs where members are stepped outside the main process: a model, built once, and steps of batches.

A worker knows its model by configuration alone. It keeps no result: what a step starts from comes with the batch.
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
"""The model of this process, by its configuration; the one before is given up."""
_ONE_AT_A_TIME = threading.Lock()  # a dask worker may have several threads, solvers have not


def step_batch(config: Mapping[str, Any], batch: Batch) -> Outcome:
    """Step a batch with the model of a configuration; the value is a Stepped."""
    with _ONE_AT_A_TIME:
        return outcome(f"model '{config.get('name')}'", partial(_stepped, config, batch))


def _stepped(config: Mapping[str, Any], batch: Batch) -> Stepped:
    # Read-only, as the main process would hand them over.
    return step_members(built(config), replace(batch, members=freeze(batch.members)))


def built(config: Mapping[str, Any]) -> Model:
    """Return this process's model, made where it is not there yet; raises a DafwError."""
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    from dafw.core.registry import registry

    key = pickle.dumps(config)
    if key not in _MODELS:
        _MODELS.clear()
        model: Model = registry().create("model", config)
        _ = model.space  # a mesh, where there is one: now, not in the first step
        _MODELS[key] = model
        # For the life of the process; what is loaded later reads the environment, which says the same.
        threadpool_limits(limits=1)
    return _MODELS[key]


def dask_setup(worker: object) -> None:
    """Prepare a worker of a dask cluster of our own: Ctrl-C is for the main process alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def build_ahead(config: Mapping[str, Any]) -> None:
    """Build the model before the first step; what goes wrong is met again there, and said."""
    outcome("", partial(built, config))


def needs_registered(executor: Executor, model: Model) -> str:
    """Return what to say where workers are asked to step a model that they cannot make."""
    return (
        f"{executor.label} makes the model anew in each worker: expected one that a package registers, "
        f"got {model.label}, which was made in Python; use the executor 'serial'"
    )
