"""``dafw new-plugin``: a package with one working plugin, and a test that runs the conformance kit on it."""

from __future__ import annotations

import keyword
from pathlib import Path
from string import Template

from dafw.core.errors import RequestError
from dafw.core.registry import registry

PYPROJECT = """\
[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"

[project]
name = "dafw-$dashed"
version = "0.1.0"
description = "The $kind '$name' for dafw"
requires-python = ">=3.12"
dependencies = ["dafw"]

[project.entry-points.dafw]
$name = "dafw_$name"

[tool.hatch.build]
dev-mode-dirs = ["."]

[tool.hatch.build.targets.wheel]
packages = ["dafw_$name"]
"""

PACKAGE = '''\
"""The $kind '$name' for dafw."""

from dafw import PluginSpec, hookimpl


@hookimpl
def dafw_plugins():
    """Return the plugins of this package."""
    return [PluginSpec("$kind", "$name", "dafw_$name.$name:$Class", "one line for `dafw plugins`")]
'''

TEST = '''\
"""Every check of dafw's conformance kit, one test each."""

import pytest


@pytest.mark.dafw("$kind", "$name")
def test_conforms(dafw_check):
    dafw_check()
'''

MODEL = '''\
"""A model to start from: every number decays towards zero."""

from dataclasses import dataclass

import numpy as np

from dafw import Model, StateSpace, Variable, option


@dataclass
class $Class(Model):
    """Exponential decay without model error."""

    rate: float = option(0.1, "decay rate in 1/s", minimum=0.0)
    dt: float = option(1.0, "time step in seconds", above=0.0)

    def __post_init__(self):
        self.space = StateSpace([Variable("level", 8, units="m")])

    def initial(self, n_members, rng):
        """Return draws (N, n) from the first guess."""
        return 1.0 + rng.standard_normal((n_members, self.space.size))

    def step(self, members, t, rng):
        """Return the members (N, n) at t + dt."""
        return members * np.exp(-self.rate * self.dt)
'''

OBSERVER = '''\
"""An observer to start from: reads the first number of the state's first variable."""

from dataclasses import dataclass

import numpy as np

from dafw import Observer, Selection, option


@dataclass
class $Class(Observer):
    """One instrument with one reading in every cycle."""

    noise_sd: float = option(0.1, "standard deviation of the readings' noise", above=0.0)

    def operator(self, space, route, t):
        """Return the observation operator: which entry of the state is read (H), and its error variance (R)."""
        return Selection(indices=np.array([0]), covariance=np.array([self.noise_sd**2]))
'''

POLICY = '''\
"""A policy to start from: every vehicle flies in a random direction, or stays if the way is blocked."""

from dataclasses import dataclass

import numpy as np

from dafw import Policy, Route, option


@dataclass
class $Class(Policy):
    """A random walk."""

    step: float = option(1.0, "flight length, as a fraction of the longest possible", minimum=0.0, maximum=1.0)

    def decide(self, belief, vehicle, rng):
        """Return the route until the next decision."""
        paths = []
        for position in vehicle.positions:
            angle = rng.uniform(0.0, 2.0 * np.pi)
            end = position + self.step * vehicle.reach * np.array([np.cos(angle), np.sin(angle)])
            free = vehicle.airspace is None or vehicle.airspace.is_free(position, end)
            paths.append(np.array([position, end if free else position]))
        return Route(tuple(paths))
'''

FILTER = '''\
"""A filter to start from: the stochastic ensemble Kalman filter."""

from dataclasses import dataclass

import numpy as np

from dafw import Analysis, Filter, option, whiten


@dataclass
class $Class(Filter):
    """Every member is compared with the readings plus a random error of its own."""

    inflation: float = option(1.0, "factor on the forecast anomalies", minimum=1.0)

    def analyse(self, forecast, predicted, observation, rng):
        """Return the analysis: mean + A + (dy - Y) (Y^T Y + (N - 1) I)^-1 Y^T A."""
        # A (N, n): inflated anomalies of the members. Y (N, m): inflated anomalies of the predicted readings.
        # dy (N, m): perturbed readings minus the mean prediction. Y and dy are scaled so that the errors have R = I.
        Y = self.inflation * whiten(observation.covariance, predicted - predicted.mean(0))
        dy = whiten(observation.covariance, observation.values - predicted.mean(0)) + rng.standard_normal(Y.shape)
        gain = np.linalg.solve(Y.T @ Y + (len(Y) - 1) * np.eye(Y.shape[1]), Y.T @ forecast.anomalies)
        return Analysis(forecast.space.retract(forecast.mean, self.inflation * (forecast.anomalies + (dy - Y) @ gain)))
'''

READINGS = '''\
"""A source of readings to start from: one sensor that is read at the end of every cycle."""

from dataclasses import dataclass

import numpy as np

from dafw import Observation, Readings, Selection, option


@dataclass
class $Class(Readings):
    """A sensor at one entry of the state's first variable."""

    entry: int = option(0, "entry of the first variable that the sensor reads", minimum=0)
    noise_sd: float = option(0.1, "standard deviation of the sensor's error", above=0.0)

    def measured(self, time):
        """Return the sensor's value at a time in seconds. Put your own instrument or file here."""
        return 1.0 + np.sin(time)

    def take(self, request, rng):
        """Return the readings that became known in the cycle that ends at request.end: here always one."""
        operator = Selection(indices=np.array([self.entry]), covariance=np.array([self.noise_sd**2]))
        return [Observation(np.array([self.measured(request.end)]), operator, request.end)]
'''

CODE = {"model": MODEL, "observer": OBSERVER, "policy": POLICY, "filter": FILTER, "readings": READINGS}


def new_plugin(kind: str, name: str, folder: Path) -> list[Path]:
    """Write a package with one plugin into a new or empty folder; return its files.

    Raises RequestError for a kind, a name or a folder that cannot be used; nothing is ever overwritten.
    """
    if kind not in CODE:
        raise RequestError(f"new-plugin: there is no kind '{kind}' (kinds: {', '.join(CODE)})")
    if not (name.isascii() and name.isidentifier() and name == name.lower()) or keyword.iskeyword(name):
        raise RequestError(f"new-plugin: expected a name of small letters, digits and '_' like my_{kind}, got '{name}'")
    if name in registry().names(kind):
        raise RequestError(f"new-plugin: the {kind} '{name}' is there already; take another name")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise RequestError(f"new-plugin: {folder} is there already and not empty; nothing was written")
    class_name = "".join(part.capitalize() for part in name.split("_")) or name
    words = {"kind": kind, "name": name, "dashed": name.replace("_", "-"), "Class": class_name}
    contents = {
        folder / "pyproject.toml": PYPROJECT,
        folder / f"dafw_{name}" / "__init__.py": PACKAGE,
        folder / f"dafw_{name}" / f"{name}.py": CODE[kind],
        folder / "tests" / f"test_{name}.py": TEST,
    }
    try:
        for path, text in contents.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(Template(text).substitute(words), encoding="utf-8")
    except OSError as error:
        raise RequestError(f"new-plugin: {folder} cannot be written: {error.strerror}") from error
    return list(contents)
