"""A model that worker processes can find, and that fails on request."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dafw import Model, StateSpace, Step, Variable, hookimpl
from dafw.core.ensemble import Diagnostic
from dafw.core.errors import SolverError, about_member
from dafw.core.hookspecs import PluginSpec
from dafw.core.options import option


@dataclass
class Trouble(Model):
    """State 0 is the member's number, states 1 and 2 are a random walk; the memory is the distance walked."""

    kind_of: str = option("none", "what goes wrong at t = 1 s with member 3")
    marker: str = option("", "file that says that it went wrong once already, or has slept enough")
    dt: float = 1.0

    space = StateSpace([Variable("number", 1), Variable("place", 2)])

    def initial(self, n_members, rng):
        return np.column_stack([np.arange(n_members), rng.standard_normal((n_members, 2))])

    def initial_memory(self, members):
        return {"way": np.zeros((len(members), 2))}

    def step_with_memory(self, members, memory, t, rng):
        if t == 1.0 and 3.0 in members[:, 0]:
            self.go_wrong(int(np.flatnonzero(members[:, 0] == 3.0)[0]))
        stepped = members.copy()
        moved = rng.standard_normal((len(members), 2))
        stepped[:, 1:] += moved
        diagnostics = {
            "moved": Diagnostic(moved.T, ("axis", "member")),
            "batch_size": Diagnostic(len(members) if self.kind_of == "not_of_members" else 7),
        }
        return Step(stepped, {"way": memory["way"] + np.abs(moved)}, diagnostics)

    def go_wrong(self, member):
        if self.kind_of == "always_killed":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.kind_of == "killed_once" and not Path(self.marker).exists():
            Path(self.marker).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if self.kind_of == "refuses":
            with about_member(member):
                raise SolverError("does not walk")
        if self.kind_of == "breaks":
            raise ValueError("a leg is broken")
        if self.kind_of == "sleeps":
            time.sleep(600.0)
            Path(self.marker).touch()


def install(tmp_path, monkeypatch):
    """Make this module a package that workers find in their registry, for as long as a test lasts."""
    package = tmp_path / "packages" / "trouble-1.0.dist-info"
    package.mkdir(parents=True)
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: trouble\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[dafw]\ntrouble = trouble\n")
    monkeypatch.syspath_prepend(str(package.parent))


@hookimpl
def dafw_plugins():
    return [PluginSpec("model", "trouble", "trouble:Trouble", "goes wrong")]
