"""Filters with re-runs against other people's implementations."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks import Measurement, benchmark
from benchmarks.environments import worker_output
from dafw import Model, StateSpace, Study, Variable
from dafw.core.rng import MemberStreams
from dafw.core.space import Array
from dafw.plugins.filters.esmda import ESMDA, coefficients
from dafw.plugins.readings.listed import Listed

PYESMDA = "pyesmda==1.0.0"
MEMBERS, CYCLES, SD = 100, 6, 0.05
MEAN, SPREAD = np.array([1.5, 0.3]), np.array([0.3, 0.1])
TRUTH = np.array([1.2, 0.45])


@dataclass
class Decay(Model):
    """An amount that decays at a rate: both numbers at the start are unknown, and drawn as ``prior`` (N, 2) says."""

    prior: Array
    dt: float = 1.0
    space: StateSpace = field(default_factory=lambda: StateSpace([Variable("amount", 1), Variable("rate", 1)]))

    def initial(self, n_members: int, rng: MemberStreams) -> Array:
        """Return the given members."""
        return self.prior

    def step(self, members: Array, t: float, rng: MemberStreams) -> Array:
        """Return the amounts a second later; the rates stay."""
        return np.column_stack([members[:, 0] * np.exp(-members[:, 1]), members[:, 1]])


def _ours(prior: Array, values: Array, seed: int, n_steps: int, decrease: float) -> list[float]:
    """Return mean and covariance of amount and rate at the start, from all readings at once."""
    readings = Listed(
        readings=[
            {"time": time + 1.0, "value": float(value), "entry": 0, "sd": SD} for time, value in enumerate(values)
        ]
    )
    filter_ = ESMDA(window=len(values), every=len(values), iterations=n_steps, decrease=decrease)
    study = Study(
        model=Decay(prior), filter=filter_, readings=readings, members=len(prior), cycles=len(values), seed=seed
    )
    start = list(study)[-1].analysis.revised[0].ensemble.members
    return [*start.mean(axis=0).tolist(), *np.cov(start, rowvar=False).ravel().tolist()]


def _worst(priors: Array, values: Array, n_steps: int, decrease: float) -> tuple[float, Sequence[Sequence[float]]]:
    """Return the largest difference of two implementations, in its standard error over the priors, and both means."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "problem.npz"
        np.savez(file, priors=priors, values=values, variance=SD**2, alpha=coefficients(n_steps, decrease))
        theirs = np.array(json.loads(worker_output(PYESMDA, "pyesmda_decay.py", [str(file)])))
    ours = np.array([_ours(prior, values, seed, n_steps, decrease) for seed, prior in enumerate(priors)])
    differences = ours - theirs
    error = differences.std(axis=0, ddof=1) / np.sqrt(len(priors))
    means = [both.mean(axis=0).round(6).tolist() for both in (ours, theirs)]
    return float(np.max(np.abs(differences.mean(axis=0)) / error)), means


@benchmark("esmda.difference_from_pyesmda")
def difference_from_pyesmda(short: bool) -> Measurement:
    """ES-MDA on a nonlinear problem of two parameters, the same first guesses, independent draws; downloads pyESMDA.

    The value is the largest difference of the means, variances and covariance of both, averaged over first guesses, in
    standard errors. If both are the same algorithm it exceeds the baseline once in a thousand times.
    """
    from scipy.stats import t

    n_priors = 8 if short else 400
    rng = np.random.default_rng(2013)
    priors = MEAN + SPREAD * rng.standard_normal((n_priors, MEMBERS, 2))
    values = TRUTH[0] * np.exp(-TRUTH[1] * np.arange(1, CYCLES + 1)) + SD * rng.standard_normal(CYCLES)
    cases = {"alpha = 4, 4, 4, 4": (4, 1.0), "alpha = 15, 7.5, 3.75, 1.875": (4, 2.0), "one step": (1, 1.0)}
    found = {name: _worst(priors, values, *case) for name, case in cases.items()}
    limit = float(t.isf(1e-3 / (2 * 5 * len(cases)), n_priors - 1))
    detail = {
        name: {"standard_errors": round(worst, 2), "dafw": means[0], "pyesmda": means[1]}
        for name, (worst, means) in found.items()
    }
    return Measurement(max(worst for worst, _ in found.values()), "standard errors", limit, detail)
