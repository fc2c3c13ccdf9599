"""The floor of a twin study: how near constant parameters can bring the model to the truth, at best.

A filter that moves nothing but the model's unknown numbers cannot come below it, whatever it reads. Under a mismatch,
such as a truth whose wind changes, the floor is not zero. It is searched for with full knowledge of the truth, by the
simplex method of Nelder and Mead (1965), doi:10.1093/comjnl/7.4.308, in the coordinates of ``Controls``. The search
begins at the truth's own numbers; one that the truth does not have begins at the mean of the first guess.

The result is the best that was found, and a local minimum: the true floor may be lower. It depends on the models alone,
not on the filter, the route or the readings, and on the seed only where the truth is drawn at random.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dafw.core.cycle import Parts
from dafw.core.diagnostics import error_of
from dafw.core.errors import ConfigurationError, DivergenceError, SolverError
from dafw.core.rerun import Rerun
from dafw.core.rng import Streams
from dafw.core.space import FIELD, Array
from dafw.core.study import Study
from dafw.plugins.filters.controls import Controls

STEP = 0.1
"""First step of the search in coordinates: a tenth of a positive number, 0.1 radians."""
SHARE = 0.2
"""First step of a number that may be negative, such as a place, as a share of its first guess' standard deviation."""
GUESSES = 100
"""Draws from the first guess, whose mean and spread stand for it."""
IMPOSSIBLE = 1e6
"""The error, in per cent, of parameters with which the model cannot run."""


@dataclass(frozen=True)
class Floor:
    """The smallest ERR that was found, in per cent, its ``parameters`` by name, and the runs of the model it took."""

    err: float
    parameters: dict[str, float]
    runs: int


def floor_of(study: Study, *, most_runs: int = 200, tolerance: float = 2e-3, any_seed: bool = False) -> Floor:
    """Return the smallest ERR at the end of a study that constant parameters reach.

    ``most_runs`` bounds the runs of the model. The search ends if the coordinates change by less than ``tolerance``.
    Raises ConfigurationError if the study has no truth, or its model no unknown numbers; with ``any_seed`` also if
    the floor would be another one for another seed, because the truth or the model's error is drawn at random.
    """
    from scipy.optimize import minimize

    if study.truth is None:
        raise ConfigurationError("a floor is measured against a truth, and the study has none")
    parts, _ = study.prepare()
    space = parts.model.space
    names = [variable.name for variable in space.variables if variable.size == 1]
    if not names:
        raise ConfigurationError(f"{parts.model.label} has no single numbers, so there are no parameters to search for")
    controls, rerun = Controls(space, names), parts.rerun
    numbers, truth = _truth(parts, study.cycles)
    another = replace(parts, streams=Streams((study.seed + 1) % 2**63))
    if any_seed and not np.array_equal(truth, _truth(another, study.cycles)[1], equal_nan=True):
        raise ConfigurationError(
            f"{study.truth.label}: the truth differs from seed to seed, so there is no floor for all seeds: expected a "
            f"truth without random numbers"
        )
    guesses = rerun.first_guess(GUESSES, "floor", 0)
    start = guesses.with_members(guesses.mean[np.newaxis])
    known = np.where(np.isnan(numbers), guesses.mean, numbers)[np.newaxis]
    begin = controls.coordinates(known)[0]
    runs = 0

    def error(coordinates: Array, rerun: Rerun = rerun) -> float:
        nonlocal runs
        runs += 1
        members = controls.at(rerun, start.members, coordinates[np.newaxis])
        try:
            end = rerun(start.with_members(members), 0, study.cycles).forecast.ensemble
        except (SolverError, DivergenceError):
            return IMPOSSIBLE
        return error_of(space, truth, end.mean)

    steps = np.array([STEP if space[name].kind is not FIELD else 0.0 for name in names])
    steps = np.where(steps > 0.0, steps, np.maximum(SHARE * guesses.spread[controls.entries], 1e-6))
    simplex = begin + np.vstack([np.zeros(len(begin)), np.diag(steps)])
    options = {"initial_simplex": simplex, "maxfev": most_runs, "xatol": tolerance, "fatol": 0.02}
    parts.executor.start(parts.model, study.model_configuration)
    with parts.executor:
        if any_seed and error(begin) != error(begin, another.rerun):
            raise ConfigurationError(
                f"{parts.model.label}: its error differs from seed to seed, so there is no floor for all seeds: "
                f"expected a model without random numbers"
            )
        found = minimize(error, begin, method="Nelder-Mead", options=options)
    best = controls.at(rerun, start.members, found.x[np.newaxis])[0, controls.entries]
    return Floor(float(found.fun), dict(zip(names, map(float, best), strict=True)), runs)


def _truth(parts: Parts, cycles: int) -> tuple[Array, Array]:
    """Return the truth at the start and after all cycles in the belief's state space, both (n,).

    NaN for numbers that it does not have. Its random numbers are those of a run.
    """
    truth, streams = parts.truth, parts.streams
    if truth is None:
        raise ConfigurationError("the study has no truth")
    now = truth.first_guess(1, streams.members("initial truth", 0))
    beginning = parts.seen(now)
    for cycle in range(cycles):
        now = truth.forecast(now.ensemble, now.memory, streams.members("truth error", cycle))
    end = parts.seen(now)
    if beginning is None or end is None:
        raise ConfigurationError("the study has no truth")
    return beginning.members[0], end.members[0]
