"""What runs where members are stepped outside the main process: a model, built once, and steps of batches.

A worker knows its model by configuration alone. It keeps no result: what a step starts from comes with the batch.
"""

from __future__ import annotations

import logging
import pickle
import signal
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

from dafw.core.ensemble import Step, freeze
from dafw.core.errors import ComputationError, DafwError
from dafw.core.executors.batches import Batch
from dafw.core.interfaces import Model

_MODELS: dict[bytes, Model] = {}
"""The model of this process, by its configuration; the one before is given up."""
_ONE_AT_A_TIME = threading.Lock()  # a dask worker may have several threads, solvers have not


@dataclass(eq=False)
class Outcome:
    """What became of a batch: its step or the error, and what was logged on the way: (logger, level, text)."""

    step: Step | None
    error: DafwError | None = None
    logged: list[tuple[str, int, str]] = field(default_factory=list)

    def relog(self) -> None:
        """Say in this process what the worker had to say."""
        for name, level, text in self.logged:
            logging.getLogger(name).log(level, "%s", text)


class _Notes(logging.Handler):
    """Keeps what is logged, to be sent home."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.taken: list[tuple[str, int, str]] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.taken.append((record.name, record.levelno, record.getMessage()))


def step_batch(config: Mapping[str, Any], batch: Batch) -> Outcome:
    """Step a batch with the model of a configuration; whatever goes wrong comes back as a DafwError."""
    notes, log = _Notes(), logging.getLogger("dafw")
    with _ONE_AT_A_TIME:
        log.addHandler(notes)
        log.setLevel(logging.INFO)
        label = f"model '{config.get('name')}'"
        try:
            model = built(config)
            # Read-only, as the main process would hand them over.
            step = model.step_with_memory(freeze(batch.members), batch.memory, batch.t, batch.rng)
            return Outcome(step, logged=notes.taken)
        except DafwError as error:
            if error.member is not None:
                error.member += batch.first
            return Outcome(None, _portable(error), notes.taken)
        except Exception as error:
            text = f"{label} raised {type(error).__name__}: {error}"
            return Outcome(None, ComputationError(text), notes.taken)
        finally:
            log.removeHandler(notes)


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


def _portable(error: DafwError) -> DafwError:
    """Return the error, or its text where it cannot travel."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return ComputationError(f"{type(error).__name__}: {error}")
    return error


def main(descriptor: int) -> None:
    """Serve (configuration, batch) from the main process until it closes its end; no batch: only build."""
    # Ctrl-C is for the main process, which ends its workers itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with Connection(descriptor) as connection:
        while True:
            try:
                config, batch = connection.recv()
                if batch is None:
                    _build_ahead(config)
                else:
                    connection.send(step_batch(config, batch))
            except (EOFError, OSError):
                return  # nobody is there any more


def dask_setup(worker: object) -> None:
    """Prepare a worker of a dask cluster of our own: Ctrl-C is for the main process alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _build_ahead(config: Mapping[str, Any]) -> None:
    try:
        built(config)
    except Exception:
        return  # the first step meets it again, and says so
