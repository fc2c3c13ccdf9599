"""Plugins that stop a run in the middle until a test lets it continue, and functions to use them in tests.

A run that a test interrupts must still be under way when the signal comes, however fast or slow the machine is. So the
run waits: in cycle ``HALT`` it writes a file ``waiting-PID`` into a folder, and continues when a file ``go`` exists. By
then the rows of the earlier cycles are on disk, because the cycle before took longer than the record keeps rows back.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil

from dafw import hookimpl
from dafw.core.hookspecs import PluginSpec
from dafw.core.options import option
from dafw.core.record import FLUSH_SECONDS
from dafw.plugins.models.lorenz96 import Lorenz96
from dafw.plugins.policies.stationary import Stationary

HALT = 3
"""The number of the cycle that waits, which is also the number of finished cycles before it."""
PATIENCE = 300.0
"""Seconds after which a test stops waiting and fails; without a fault they never pass."""


def halt(folder: str, cycle: int) -> None:
    """Wait in cycle ``HALT`` for the file ``go``."""
    if cycle == HALT - 1:
        time.sleep(1.1 * FLUSH_SECONDS)
    if cycle == HALT:
        Path(folder, f"waiting-{os.getpid()}").touch()
        until(Path(folder, "go").exists, "the file 'go'")
    if cycle > HALT:
        # A signal that a launcher passes on takes some time; the run must not end before it arrives.
        time.sleep(0.05)


def halt_task(folder: str, *task: object) -> None:
    """Wait in a worker, instead of computing."""
    halt(folder, HALT)


@dataclass
class Halting(Stationary):
    """No vehicle moves, and one decision waits."""

    folder: str = option("", "folder of the files 'waiting-PID' and 'go'")

    def decide(self, belief, vehicle, rng):
        halt(self.folder, round(belief.time / vehicle.dt))
        return super().decide(belief, vehicle, rng)


@dataclass
class HaltingLorenz96(Lorenz96):
    """Lorenz-96 in which one step waits; no step waits if no folder is named."""

    folder: str = option("", "folder of the files 'waiting-PID' and 'go'")

    def step(self, members, t, rng):
        if self.folder:
            halt(self.folder, round(t / self.dt))
        return super().step(members, t, rng)


@hookimpl
def dafw_plugins():
    return [
        PluginSpec("policy", "halting", "waiting:Halting", "one decision waits"),
        PluginSpec("model", "halting_lorenz96", "waiting:HaltingLorenz96", "one step waits"),
    ]


def plugin_path(folder: Path) -> str:
    """Install the plugins of this module for processes whose PYTHONPATH is what this returns."""
    package = folder / "waiting-1.0.dist-info"
    package.mkdir(parents=True)
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: waiting\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[dafw]\nwaiting = waiting\n")
    return os.pathsep.join([str(folder), str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])


@contextmanager
def halted(words: list[str], folder: Path, waiting: int = 1, **more: object) -> Iterator[subprocess.Popen[str]]:
    """Start a command in ``folder``; yield its process when ``waiting`` processes wait. Files are in ``folder/halt``.

    ``words`` are arguments of ``python``, or a whole command that begins with a path. It is killed when the block ends.
    """
    place = folder / "halt"
    place.mkdir()
    command = words if Path(words[0]).is_absolute() else [sys.executable, *words]
    environment = {**os.environ, "PYTHONPATH": plugin_path(folder / "packages")}
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, cwd=folder, env=environment, **pipes, **more) as process:

        def arrived() -> bool:
            assert process.poll() is None, process.stderr.read()
            return len(list(place.glob("waiting-*"))) >= waiting

        try:
            until(arrived, "a run that waits")
            yield process
        finally:
            process.kill()


def go_on(folder: Path) -> None:
    """Let a run that waits in ``folder`` continue."""
    (folder / "halt" / "go").touch()


def until(condition: Callable[[], bool], what: str) -> None:
    """Wait for a condition; after ``PATIENCE`` the test fails with a message that names it."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(f"waited {PATIENCE:g} s in vain for {what}")
        time.sleep(0.01)


def runs(process: int) -> bool:
    """Return whether a process runs; a process that has ended but was not waited for does not."""
    try:
        return psutil.Process(process).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def ended(processes: list[int]) -> bool:
    """Return whether all processes end; a signal may need some time to reach them."""
    until(lambda: not any(map(runs, processes)), f"the end of processes {processes}")
    return True


def children(process: int) -> list[int]:
    """Return the processes that a process started and that still run."""
    return [child.pid for child in psutil.Process(process).children() if runs(child.pid)]
