"""Worker processes on this machine: new Python interpreters that run functions for the main process.

Workers are not forked, because PETSc and its threads do not survive a fork. They do not import the user's script
either. A worker ends when its connection is closed, so no worker outlives the process that started it.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Generator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, Pipe, wait
from queue import SimpleQueue
from typing import Any

from dafw.core.errors import ComputationError, DafwError

log = logging.getLogger("dafw")

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"), "1")
LAUNCHERS = ("PMI", "OMPI_")
"""Prefixes of the environment variables that mpirun sets. A worker that saw them would join the MPI job."""
PATIENCE = 5.0
"""Seconds that an idle worker is given to end before it is killed."""
REPLACED = 2
"""How many lost workers ``run_tasks`` replaces."""
PROGRAM = "import sys; sys.path[:] = {path!r}; from dafw.core.workers import serve; serve({descriptor})"

_HELPING: ContextVar[bool] = ContextVar("helping", default=False)


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def spare_cores() -> int:
    """Return how many worker processes have a core of their own; 1 in a worker, which starts none itself."""
    return 1 if _HELPING.get() else cores()


@dataclass(eq=False)
class Outcome:
    """The result of a call in a worker: a value or an error, and what was logged meanwhile (logger, level, text)."""

    value: Any
    error: DafwError | None = None
    logged: list[tuple[str, int, str]] = field(default_factory=list)

    def get(self) -> Any:
        """Repeat the worker's log messages in this process; return the value or raise the error."""
        for name, level, text in self.logged:
            logging.getLogger(name).log(level, "%s", text)
        if self.error is not None:
            raise self.error
        return self.value


class _Notes(logging.Handler):
    """Collects log messages, to be sent to the main process."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.taken: list[tuple[str, int, str]] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.taken.append((record.name, record.levelno, record.getMessage()))


def outcome(label: str, call: Callable[[], Any]) -> Outcome:
    """Return what a call gives in a worker. Any exception becomes a DafwError; ``label`` names who raised it."""
    notes = _Notes()
    log.addHandler(notes)
    log.setLevel(logging.INFO)
    helping = _HELPING.set(True)
    try:
        return Outcome(call(), logged=notes.taken)
    except DafwError as error:
        return Outcome(None, _portable(error), notes.taken)
    except Exception as error:
        return Outcome(None, ComputationError(f"{label} raised {type(error).__name__}: {error}"), notes.taken)
    finally:
        _HELPING.reset(helping)
        log.removeHandler(notes)


def _portable(error: DafwError) -> DafwError:
    """Return the error, or a ComputationError with its text if it cannot be pickled."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return ComputationError(f"{type(error).__name__}: {error}")
    return error


def serve(descriptor: int) -> None:
    """Run what the main process sends, (function, arguments, whether it waits for the result), until it disconnects."""
    # Ctrl-C is for the main process, which ends its workers itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    connection, messages = Connection(descriptor), SimpleQueue[Any]()
    threading.Thread(target=_listen, args=(connection, messages), daemon=True).start()
    while True:
        function, arguments, awaited = messages.get()
        done = function(*arguments)
        sys.stdout.flush()
        if awaited:
            with contextlib.suppress(OSError):  # the main process is gone; ``_listen`` notices that
                connection.send(done)


def _listen(connection: Connection, messages: SimpleQueue[Any]) -> None:
    """Receive messages while a function runs. End the process at once when the main process disconnects."""
    status = 1
    try:
        while True:
            messages.put(connection.recv())
    except (EOFError, OSError):
        status = 0
    except Exception:  # whatever unpickling raises; os._exit below would swallow it
        traceback.print_exc()
    finally:
        os._exit(status)


def _environment() -> dict[str, str]:
    """Return the environment of a worker: this process's, with one thread and without the variables of mpirun."""
    own = {name: value for name, value in os.environ.items() if not name.startswith(LAUNCHERS)}
    return own | ONE_THREAD


class Worker:
    """One worker process and the connection to it."""

    def __init__(self) -> None:
        self.connection, theirs = Pipe()
        with theirs:
            # The same interpreter and path. A process group of its own, so that Ctrl-C does not reach it. What it
            # prints goes to standard error, because standard output holds the command's results.
            self.process = subprocess.Popen(
                [
                    sys.executable,
                    "-c",
                    PROGRAM.format(path=[str(entry) for entry in sys.path], descriptor=theirs.fileno()),
                ],
                stdin=subprocess.DEVNULL,
                stdout=2,
                env=_environment(),
                pass_fds=[theirs.fileno()],
                process_group=0,
            )
        self.busy = False

    def tell(self, function: Callable[..., Any], *arguments: Any) -> None:
        """Run ``function(*arguments)`` in the worker and discard the result; it must be of an importable module."""
        with contextlib.suppress(OSError):  # a lost worker is noticed when its next result is awaited
            self.connection.send((function, arguments, False))

    def ask(self, function: Callable[..., Outcome], *arguments: Any) -> None:
        """Run ``function(*arguments)`` in the worker; ``receive`` returns its result."""
        self.busy = True
        with contextlib.suppress(OSError):
            self.connection.send((function, arguments, True))

    def receive(self) -> Outcome | None:
        """Wait for the result of the oldest ``ask``; None if the worker ended instead."""
        try:
            received: Outcome = self.connection.recv()
        except (EOFError, OSError):
            return None
        self.busy = False
        return received

    def dismiss(self) -> None:
        """Disconnect, which ends the worker; kill it if it is busy."""
        self.connection.close()
        if self.busy:
            self.process.kill()

    def end(self) -> int:
        """End the worker and wait for it; return its exit status, negative for the number of a signal."""
        self.dismiss()
        try:
            return self.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()

    def lost(self) -> str:
        """Clean up after a worker that ended unexpectedly; return how: ``(process 71) was killed by signal 9``."""
        status = self.end()
        how = f"killed by signal {-status}" if status < 0 else f"ended with status {status}"
        return f"(process {self.process.pid}) was {how}"


def dismiss(workers: Sequence[Worker]) -> None:
    """End all workers and wait until they are gone."""
    for worker in workers:
        worker.dismiss()
    for worker in workers:
        worker.end()


def run_tasks(
    function: Callable[..., Outcome], tasks: Sequence[tuple[Any, ...]], workers: int, what: str
) -> Generator[tuple[int, Any]]:
    """Run ``function(*task)`` for all tasks in several workers; yield the number and value of each task as it ends.

    If not all values are used, close the generator (contextlib.closing): that ends the workers. Raises what a call
    raises, and ComputationError, which says ``what`` was being done, if more than ``REPLACED`` workers are lost.
    """
    pool: list[Worker] = []
    todo, at = list(range(len(tasks)))[::-1], {}
    lost = 0
    try:
        for _ in range(min(workers, len(tasks))):
            pool.append(worker := Worker())
            at[worker] = todo.pop()
            worker.ask(function, *tasks[at[worker]])
        while at:
            ready = wait([worker.connection for worker in at])
            for worker in [worker for worker in at if worker.connection in ready]:
                received, number = worker.receive(), at.pop(worker)
                if received is None:
                    lost += 1
                    said = f"{what}: a worker {worker.lost()}"
                    if lost > REPLACED:
                        raise ComputationError(f"{said}; {lost} were lost, at most {REPLACED} are replaced")
                    log.warning("%s; another does its work again", said)
                    pool.remove(worker)
                    pool.append(worker := Worker())
                    todo.append(number)
                if todo:
                    at[worker] = todo.pop()
                    worker.ask(function, *tasks[at[worker]])
                if received is not None:
                    yield number, received.get()
    finally:
        dismiss(pool)
