"""A model that is an external program: one process for each member and step.

By default a process reads standard input: a line with t, dt (seconds) and n, then the n numbers of the member, one a
line. It writes the n numbers at t + dt to standard output, separated by white space. For a program that uses files,
override ``prepare`` and ``result``, which write and read them. Each process runs in an empty folder of its own, which
is removed afterwards.

The class that a package registers determines the program, never an option: options come from configuration files, and
these are passed between people. Installing a package means trusting its code; running a study from another person must
not require trust. For the same reason there is no shell: options reach the program as separate arguments.
"""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from dafw.core.errors import ComputationError, ContractError
from dafw.core.interfaces import Model
from dafw.core.options import option
from dafw.core.rng import MemberStreams
from dafw.core.space import Array

LAST_LINES = 3
"""Lines of a failed program's output that its error repeats."""


@dataclass
class ProgramModel(Model):
    """Base class: a subclass sets ``command``, ``space``, ``dt`` and ``initial``, and may define the rest.

    ``step`` raises ComputationError, with the member, the exit status and the program's last lines, if a program
    cannot be started, fails or takes longer than ``time_limit``. In the last case it is killed with its children.
    """

    command: ClassVar[Sequence[str]]

    time_limit: float = option(60.0, "time limit for one step of one member, in seconds", above=0.0)

    def arguments(self) -> Sequence[str]:
        """Return the arguments after the command, for example values of this class's options."""
        return ()

    def prepare(self, folder: Path, values: Array, t: float) -> str:
        """Return the standard input for one member (n,); write input files into ``folder`` if the program uses them."""
        numbers = "\n".join(repr(float(value)) for value in values)  # repr is exact
        return f"{t!r} {self.dt!r} {len(values)}\n{numbers}\n"

    def result(self, folder: Path, output: str) -> Array:
        """Return the member (n,) at t + dt from standard output, or from the files in ``folder``."""
        return np.array(output.split(), dtype=np.float64)

    def step(self, members: Array, t: float, rng: MemberStreams) -> Array:
        """Return the members (N, n) at t + dt.

        For its model error, each process gets its own seed in the environment variable DAFW_SEED.
        """
        return np.stack([self._one(i, values, t, int(rng[i].integers(2**63))) for i, values in enumerate(members)])

    def _one(self, member: int, values: Array, t: float, seed: int) -> Array:
        where = f"{self.label}, member {member}, t = {t:g} s"
        with tempfile.TemporaryDirectory(prefix="dafw-") as name:
            folder = Path(name)
            work = folder / "work"
            work.mkdir()
            (folder / "input").write_text(self.prepare(work, values, t), encoding="utf-8")
            status = self._run(folder, work, {**os.environ, "DAFW_SEED": str(seed)}, where)
            output = (folder / "output").read_text(encoding="utf-8", errors="replace")
            if status != 0:
                raise ComputationError(f"{where}: {self.command[0]} {_ending(status)}{self._last_lines(folder)}")
            try:
                result = self.result(work, output)
            except (ValueError, OSError) as error:
                raise ContractError(f"{where}: {self.command[0]} left no numbers that can be read: {error}") from error
        return self.checked(result, values.shape, f"member {member} after a step")

    def _run(self, folder: Path, work: Path, environment: dict[str, str], where: str) -> int:
        """Run the program to its end and return its status; negative: the signal that ended it."""
        command = [*self.command, *self.arguments()]
        # Files, not pipes: nothing blocks on them, however much is written and whichever process keeps them open.
        with (
            (folder / "input").open("rb") as given,
            (folder / "output").open("wb") as output,
            (folder / "errors").open("wb") as errors,
        ):
            try:
                process = subprocess.Popen(
                    command,
                    stdin=given,
                    stdout=output,
                    stderr=errors,
                    cwd=work,
                    env=environment,
                    start_new_session=True,
                )
            except OSError as error:
                raise ComputationError(f"{where}: {command[0]} cannot be started: {error.strerror}") from error
            try:
                return process.wait(self.time_limit)
            except subprocess.TimeoutExpired as error:
                raise ComputationError(
                    f"{where}: {command[0]} was stopped after the time limit of {self.time_limit:g} s"
                    f"{self._last_lines(folder)}"
                ) from error
            finally:
                # However the wait ended, Ctrl-C included, the program and its children must not outlive the step.
                _kill_group(process)

    def _last_lines(self, folder: Path) -> str:
        """Return the last lines of the program's output: of standard error if it wrote any, else standard output."""
        for name in ("errors", "output"):
            text = (folder / name).read_bytes()[-10_000:].decode("utf-8", errors="replace")
            if lines := [line.strip() for line in text.splitlines() if line.strip()]:
                return "; its last lines: " + " | ".join(lines[-LAST_LINES:])
        return "; it said nothing"


def _kill_group(process: subprocess.Popen[bytes]) -> None:
    """Kill the process and its children if they still run, and leave no zombie."""
    with suppress(ProcessLookupError, PermissionError):  # all of them have ended
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _ending(status: int) -> str:
    if status > 0:
        return f"ended with exit status {status}"
    try:
        return f"was ended by {signal.Signals(-status).name}"
    except ValueError:
        return f"was ended by signal {-status}"
