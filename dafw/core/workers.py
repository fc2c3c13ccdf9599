"""Worker processes of this machine: fresh interpreters that call what they are told to call.

Never a fork: PETSc and its threads survive none. And not the user's script once more: no ``__main__`` is imported.
Closing its connection ends a worker, so that none outlives the process that started it, however that ends.
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
"""What variables of an mpirun begin with; a worker that had them would take part in its job."""
PATIENCE = 5.0
"""Seconds that an idle worker has to end by itself."""
REPLACED = 2
"""How many lost workers ``share_out`` replaces."""
PROGRAM = "import sys; sys.path[:] = {path!r}; from dafw.core.workers import serve; serve({descriptor})"

_HELPING: ContextVar[bool] = ContextVar("helping", default=False)


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def spare_cores() -> int:
    """Return for how many worker processes there are cores: one, this process itself, where it is a worker."""
    return 1 if _HELPING.get() else cores()


@dataclass(eq=False)
class Outcome:
    """What became of a call: its value or its error, and what was logged on the way: (logger, level, text)."""

    value: Any
    error: DafwError | None = None
    logged: list[tuple[str, int, str]] = field(default_factory=list)

    def get(self) -> Any:
        """Say in this process what the worker had to say; return the value or raise the error."""
        for name, level, text in self.logged:
            logging.getLogger(name).log(level, "%s", text)
        if self.error is not None:
            raise self.error
        return self.value


class _Notes(logging.Handler):
    """Keeps what is logged, to be sent home."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.taken: list[tuple[str, int, str]] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.taken.append((record.name, record.levelno, record.getMessage()))


def outcome(label: str, call: Callable[[], Any]) -> Outcome:
    """Call in a worker: whatever goes wrong comes back as a DafwError; ``label`` names who raised what is none."""
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
    """Return the error, or its text where it cannot travel."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return ComputationError(f"{type(error).__name__}: {error}")
    return error


def serve(descriptor: int) -> None:
    """Call what the main process sends until it closes its end: (function, arguments, whether it waits for them)."""
    # Ctrl-C is for the main process, which ends its workers itself.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    connection, messages = Connection(descriptor), SimpleQueue[Any]()
    threading.Thread(target=_listen, args=(connection, messages), daemon=True).start()
    while True:
        function, arguments, awaited = messages.get()
        done = function(*arguments)
        sys.stdout.flush()
        if awaited:
            with contextlib.suppress(OSError):  # nobody is there any more, which ``_listen`` sees
                connection.send(done)


def _listen(connection: Connection, messages: SimpleQueue[Any]) -> None:
    """Take messages while others are worked on; end the process in the middle of its work where nobody wants it."""
    status = 1
    try:
        while True:
            messages.put(connection.recv())
    except (EOFError, OSError):
        status = 0
    except Exception:
        traceback.print_exc()
    finally:
        os._exit(status)


def _environment() -> dict[str, str]:
    """Return this process's environment for a worker: one thread, and no rank of an MPI job, which it is not."""
    own = {name: value for name, value in os.environ.items() if not name.startswith(LAUNCHERS)}
    return own | ONE_THREAD


class Worker:
    """One worker process and the connection to it."""

    def __init__(self) -> None:
        self.connection, theirs = Pipe()
        with theirs:
            # The same interpreter and path; a group of its own, out of reach of Ctrl-C; what is printed there must not
            # get between a command's results.
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
        """Have a function of an importable module called, for what it does there."""
        with contextlib.suppress(OSError):  # a worker that is gone shows when it is waited for
            self.connection.send((function, arguments, False))

    def ask(self, function: Callable[..., Outcome], *arguments: Any) -> None:
        """Have a function of an importable module called; ``receive`` gives what it returns."""
        self.busy = True
        with contextlib.suppress(OSError):
            self.connection.send((function, arguments, True))

    def receive(self) -> Outcome | None:
        """Wait for the outcome that was asked for; None where the worker ended instead."""
        try:
            received: Outcome = self.connection.recv()
        except (EOFError, OSError):
            return None
        self.busy = False
        return received

    def dismiss(self) -> None:
        """Tell the worker to end: at once where it is at something that nobody waits for."""
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

    def lost(self) -> str:
        """See off a worker that ended; say how: ``(process 71) was killed by signal 9``."""
        status = self.end()
        how = f"killed by signal {-status}" if status < 0 else f"ended with status {status}"
        return f"(process {self.process.pid}) was {how}"


def dismiss(workers: Sequence[Worker]) -> None:
    """End workers; returns when they are gone."""
    for worker in workers:
        worker.dismiss()
    for worker in workers:
        worker.end()


def share_out(
    function: Callable[..., Outcome], tasks: Sequence[tuple[Any, ...]], workers: int, what: str
) -> Generator[tuple[int, Any]]:
    """Call ``function(*task)`` for all tasks in some workers; yield number and value of each when it is there.

    Close what this returns where it is not used up (contextlib.closing): that ends the workers. Raises what a call
    raises, and ComputationError, which says ``what`` was lost, where workers die again and again.
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
